"""What the costmap of a navigation stack makes of forecasts, beside the forecasts themselves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from envpred.horizons import in_seconds
from envpred.pictures.grids import BLACK, ORANGE, figure

LETHAL, NO_INFORMATION = 254, 255  # costs of nav2_costmap_2d
UNKNOWN, OUTSIDE = "#b8ccdb", "#f3ead8"  # colours of what has no cost


class Shown(NamedTuple):
    """An occupancy grid of one horizon.

    Args:
        ahead: seconds from the last frame shown.
        rows: (height, width) percent occupied or -1, the first row in the south.
        resolution: side of a cell in metres.
        origin: outer corner of the first cell, metres.
    """

    ahead: float
    rows: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]


def costs(rows: NDArray[np.int8], trinary: bool, lethal_threshold: int = 100) -> NDArray[np.uint8]:
    """Costs that nav2's static layer reads out of an occupancy grid with unknown space tracked (`interpretValue`).

    Args:
        rows: percent occupied, or -1.
        trinary: its `trinary_costmap`: all that is known and below lethal is free.
        lethal_threshold: its `lethal_cost_threshold`.
    """
    scaled = np.floor(rows.astype(np.float64) / lethal_threshold * LETHAL)
    below = np.zeros_like(scaled) if trinary else scaled
    known = np.where(rows >= lethal_threshold, LETHAL, below)
    return np.where(rows < 0, NO_INFORMATION, known).astype(np.uint8)


def costmaps(shown: Sequence[Shown], ego: tuple[float, float], title: str) -> Figure:
    """Costs of some horizons: above as they are scaled, below with `trinary_costmap` as it is by default.

    Args:
        shown: horizons.
        ego: where the ego is at the last frame shown, metres.
        title: of the picture.
    """
    fig = figure(2.9 * len(shown) + 1.3, 6.4)
    axes = fig.subplots(2, len(shown), sharex=True, sharey=True, squeeze=False)
    greys = np.linspace(1, 0, LETHAL + 1)  # white to black, as forecasts are drawn
    colours = ListedColormap([*zip(greys, greys, greys, strict=True), to_rgb(UNKNOWN)])
    for column, (ahead, rows, resolution, origin) in enumerate(shown):
        west, south = origin[0] - ego[0], origin[1] - ego[1]
        extent = west, west + resolution * rows.shape[1], south, south + resolution * rows.shape[0]
        for row, trinary in enumerate((False, True)):
            ax = axes[row, column]
            ax.set_facecolor(OUTSIDE)
            ax.imshow(
                costs(rows, trinary),
                origin="lower",
                extent=extent,
                cmap=colours,
                vmin=-0.5,
                vmax=NO_INFORMATION + 0.5,
                interpolation="nearest",
            )
            ax.plot(0, 0, "o", color=ORANGE, markeredgecolor=BLACK, markersize=5)
        axes[0, column].set_title(f"in {in_seconds(ahead)}")
        axes[1, column].set_xlabel("east (m)")
    corners = np.array([(o, (o[0] + r * g.shape[1], o[1] + r * g.shape[0])) for _, g, r, o in shown]) - ego
    (west, south), (east, north) = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    axes[0, 0].set(xlim=(west, east), ylim=(south, north))
    for row, name in enumerate(("trinary_costmap: false", "trinary_costmap: true")):
        axes[row, 0].set_ylabel(f"{name}\nnorth (m)")
    known = ScalarMappable(Normalize(0, LETHAL), "gray_r")
    bar = fig.colorbar(known, ax=axes, shrink=0.5, ticks=[0, LETHAL // 2, LETHAL])
    bar.ax.set_yticklabels(["0: free", "127", "254: lethal"], fontsize=7)
    bar.ax.set_title("cost", fontsize=8)
    patches = [Patch(color=UNKNOWN, label="255: unknown"), Patch(color=OUTSIDE, label="outside of the grid")]
    now = Line2D([], [], linestyle="", marker="o", color=ORANGE, markeredgecolor=BLACK, label="the ego now")
    fig.legend(handles=[*patches, now], loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    fig.suptitle(title, fontsize=10)
    return fig
