"""What a rollout's forecast is made of: the world, what rays measure of it, the network's correction, and the error."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from envpred.horizons import in_seconds
from envpred.pictures.grids import SKY, SMALL, TEXT, Grid, draw_grid, edges
from envpred.pictures.panels import colour_bar, entitle, label_rows, mark_oracle, metres, panels
from envpred.results.scenes import Grids, Scene

UNSEEN = "#dddddd"
DIVERGING = "PuOr"  # as errors: orange where there is too little
LARGEST = 0.3  # of a correction, as far as colours tell


def rollout_strip(
    scene: Scene, world: Grids, rendered: Grids, corrected: Grids | None = None, title: str | None = None
) -> Figure:
    """The world over the rendered forecast over its correction over the error that is left, at the shown horizons.

    Args:
        scene: the window; horizons without a target are left out.
        world: (N, W, W) probability of a hit on the context grid of the last frame shown, NaN where nobody looks; the
            judged grid of each horizon is outlined.
        rendered: (N, H, W) probability of occupied.
        corrected: (N, H, W) the same, corrected; None of a forecaster without a correction, and the row is left out.
        title: of the whole, by default drive and frame.
    """
    forecast = rendered if corrected is None else corrected
    shown = [h for h in scene.shown if h <= min(len(scene.target), len(rendered))]
    names = ["world", "rendered", *(["corrected - rendered"] if corrected is not None else []), "forecast - target"]
    fig, axes = panels(len(shown), len(names))
    now = len(scene.seen) - 1
    for column, h in enumerate(shown):
        target = scene.target[h - 1]
        moved = scene.centre_cell[now + h] - scene.centre_cell[now]
        hits = _draw_world(axes[0][column], world[h - 1], target.shape[0], moved, scene.resolution)
        axes[0][column].set_title(in_seconds(h * scene.period), fontsize=TEXT, pad=3)
        grey = draw_grid(axes[1][column], rendered[h - 1], scene.resolution, cmap="gray_r", vmin=0, vmax=1)
        axes[1][column].set_xlabel(_mse(rendered[h - 1], target), fontsize=SMALL, labelpad=2)
        if corrected is not None:
            correction = _draw_difference(axes[2][column], corrected[h - 1] - rendered[h - 1], scene, LARGEST)
        error = _draw_difference(axes[-1][column], forecast[h - 1] - target, scene, 1)
        axes[-1][column].set_xlabel(_mse(forecast[h - 1], target), fontsize=SMALL, labelpad=2)
    label_rows(axes, names)
    _look_closer(axes[0], world[[h - 1 for h in shown]], scene.resolution)
    if scene.oracles:
        mark_oracle(axes[1])
    colour_bar(axes[0][-1], hits, "probability of a hit")
    colour_bar(axes[1][-1], grey, "probability of occupied")
    if corrected is not None:
        colour_bar(axes[2][-1], correction, "correction")
    colour_bar(axes[-1][-1], error, "error")
    entitle(fig, scene.where if title is None else title)
    return fig


def _draw_world(ax: Axes, world: Grid, cells: int, moved: NDArray[np.integer], resolution: float) -> AxesImage:
    """The world, and the outline of a judged grid of so many `cells` that lies `moved` (2,) cells further."""
    ax.set_facecolor(UNSEEN)
    image = draw_grid(ax, world, resolution, cmap="gray_r", vmin=0, vmax=1)
    ax.autoscale(False)
    low, high = edges(cells, resolution)
    corner = (low + float(moved[0]) * resolution, low + float(moved[1]) * resolution)
    ax.add_patch(Rectangle(corner, high - low, high - low, fill=False, color=SKY, linewidth=1, linestyle="--"))
    return image


def _look_closer(row: Sequence[Axes], world: Grids, resolution: float) -> None:
    """Show of the world what is looked at, a square of one size at all horizons, with metres below: they differ."""
    known = np.argwhere(~np.isnan(world).all(axis=0))
    low, high = known.min(axis=0), known.max(axis=0) + 1
    side = (high - low).max()
    first = edges(world.shape[-1], resolution)[0] + (low - (side - (high - low)) // 2) * resolution
    for ax in row:
        ax.set_xlim(first[0], first[0] + side * resolution)
        ax.set_ylim(first[1], first[1] + side * resolution)
        ax.xaxis.set_major_locator(metres())


def _draw_difference(ax: Axes, difference: Grid, scene: Scene, largest: float) -> AxesImage:
    """A difference of probabilities, white where there is none."""
    return draw_grid(ax, difference, scene.resolution, cmap=DIVERGING, vmin=-largest, vmax=largest)


def _mse(forecast: Grids, target: Grids) -> str:
    return f"MSE {np.mean((forecast - target) ** 2):.4f}"
