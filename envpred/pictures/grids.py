"""Pictures of grids, scans and curves: the command line, TensorBoard and reports call these.

Grids are drawn as maps, east to the right and north up, with metres from the centre cell on the axes.  Occupancy is
drawn as the field draws it, white free and black occupied; other colours are those of Okabe and Ito, which people with
any kind of colour vision tell apart.
"""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.store.files import check_place, replaced

Grid = NDArray[np.floating] | NDArray[np.uint8]

LABEL_COLOURS = {UNKNOWN: "#bbbbbb", OCCUPIED: "#000000", FREE: "#ffffff", EGO: "#e69f00"}
LABEL_NAMES = {UNKNOWN: "unknown", OCCUPIED: "occupied", FREE: "free", EGO: "ego"}
ORANGE, SKY, GREEN, VERMILION, GREY = "#e69f00", "#56b4e9", "#009e73", "#d55e00", "#999999"
BLUE, PURPLE, BLACK = "#0072b2", "#cc79a7", "#000000"

SINGLE, DOUBLE = 3.5, 7.16  # inches; the widths of one column and of two in the IEEE's journals
TEXT, SMALL = 8, 7  # points; smaller is not read in print
FINE, COARSE = 220, 130  # dots an inch of what is as wide as a column, or wider than a page


def figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """A figure of `width` x `height` inches that needs no screen and no global state."""
    fig = Figure(figsize=(width, height), layout=layout, dpi=FINE if width <= DOUBLE else COARSE)
    FigureCanvasAgg(fig)
    return fig


def check_picture(file: Path, or_animation: bool = False) -> None:
    """Refuse a picture (`or_animation`) that could not be written, before anything is read or drawn for it.

    Raises:
        UserError: naming endings that tell a format, or what is in the way of the file.
    """
    endings = {*FigureCanvasAgg.get_supported_filetypes()} - {"gif"} | ({"gif"} if or_animation else set())
    if file.suffix.lstrip(".") not in endings:
        told = ".png, .pdf, .svg or .gif" if or_animation else ".png, .pdf or .svg"
        raise UserError(f"{file}: no picture that can be written; end its name on {told}")
    check_place(file)


def save(picture: Figure | bytes, file: Path | str) -> Path:
    """Write a figure to `file`, whose ending decides the format, or the bytes of an animation; whole or not at all."""
    file = Path(file)
    check_picture(file, isinstance(picture, bytes))
    file.parent.mkdir(parents=True, exist_ok=True)
    with replaced(file) as part:
        if isinstance(picture, bytes):
            part.write_bytes(picture)
        else:
            # TrueType: journals refuse Type 3, which is what fonts of a PDF are by default.
            with matplotlib.rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):
                picture.savefig(part, dpi="figure")
    return file


def edges(cells: int, resolution: float) -> tuple[float, float]:
    """Where a grid of so many cells of `resolution` metres begins and ends, in metres from its centre cell's middle."""
    half = cells // 2
    return (-half - 0.5) * resolution, (cells - half - 0.5) * resolution


def draw_grid(ax: Axes, grid: Grid, resolution: float, **options: Any) -> AxesImage:
    """Draw `grid` (H, W), cells of `resolution` metres, as a map: east right, north up, metres from the centre cell.

    Its cells keep their edges; a PDF holds them as they are, one pixel a cell, at any size.
    """
    low, high = edges(grid.shape[0], resolution)
    return ax.imshow(grid.T, origin="lower", extent=(low, high, low, high), interpolation="none", **options)


def draw_labels(ax: Axes, labels: NDArray[np.uint8], resolution: float) -> None:
    """Draw a label grid (H, W) of cells of `resolution` metres with a key of its codes."""
    colours = ListedColormap([LABEL_COLOURS[code] for code in sorted(LABEL_COLOURS)])
    draw_grid(ax, labels, resolution, cmap=colours, vmin=-0.5, vmax=3.5)
    for code, name in LABEL_NAMES.items():
        ax.plot([], [], "s", color=LABEL_COLOURS[code], markeredgecolor="#444444", label=name)
    ax.legend(loc="upper right", fontsize=7, framealpha=0.9)
    ax.set_xlabel("east (m)")
    ax.set_ylabel("north (m)")


def mapping_overview(labels: NDArray[np.uint8], mass: NDArray[np.float32], resolution: float) -> Figure:
    """One mapped frame: label grid (H, W), masses of occupied and free (2, H, W), and the probability of occupied.

    Cells are `resolution` metres wide.
    """
    fig = figure(15.5, 4.2)
    axes = fig.subplots(1, 4, sharex=True, sharey=True)
    draw_labels(axes[0], labels, resolution)
    panels = (
        ("mass of occupied", mass[0], "viridis"),
        ("mass of free", mass[1], "viridis"),
        ("probability of occupied", pignistic(mass), "gray_r"),
    )
    axes[0].set_title("label grid")
    for ax, (name, grid, colours) in zip(axes[1:], panels, strict=True):
        fig.colorbar(draw_grid(ax, grid, resolution, cmap=colours, vmin=0, vmax=1), ax=ax, shrink=0.8)
        ax.set_title(name)
        ax.set_xlabel("east (m)")
    return fig


def drive_animation(labels: NDArray[np.uint8], mass: NDArray[np.floating], period: float, scale: int = 2) -> bytes:
    """A GIF of a whole drive at its own pace: label grids (T, H, W) left, probability of occupied right.

    Args:
        labels: codes (T, H, W).
        mass: of occupied and free (T, 2, H, W).
        period: seconds between frames.
        scale: pixels a cell.
    """
    palette = np.array([[int(LABEL_COLOURS[code][k : k + 2], 16) for k in (1, 3, 5)] for code in range(4)], np.uint8)

    def frame(t: int) -> Image.Image:
        grey = (255 * (1 - np.clip(pignistic(mass[t]), 0, 1))).astype(np.uint8)
        tiles = [palette[labels[t]], np.repeat(grey[..., None], 3, axis=2)]
        tile = np.concatenate([tile.transpose(1, 0, 2)[::-1] for tile in tiles], axis=1)  # as maps: north up
        return Image.fromarray(tile.repeat(scale, 0).repeat(scale, 1))

    return gif(frame, range(len(labels)), period)


def gif(frame: Callable[[int], Image.Image], steps: Sequence[int], seconds: float) -> bytes:
    """The frames of these `steps` as a GIF that repeats and shows each for so many `seconds`.

    On a terminal, one that takes longer than a second tells how far it is.
    """
    told = tqdm(steps, "drawing", unit="frame", leave=False, delay=1, disable=None)
    frames = map(frame, told)  # each is drawn as it is written
    out = io.BytesIO()
    next(frames).save(out, "GIF", save_all=True, append_images=frames, duration=round(1000 * seconds), loop=0)
    return out.getvalue()


def ground_comparison(points: NDArray[np.float32], verdicts: dict[str, NDArray[np.bool_]]) -> Figure:
    """One scan from above, in the sensor frame: obstacle points of each method, and where the methods differ.

    Args:
        points: (N, >=3) in metres.
        verdicts: for two methods by name, which points are obstacles (N,).
    """
    (first, a), (second, b) = verdicts.items()
    fig = figure(DOUBLE, 3.4)
    axes = fig.subplots(1, 3, sharex=True, sharey=True)
    layers = [
        (f"obstacles of {first}", [(a, "#000000", "obstacle"), (~a, "#dddddd", "ground")]),
        (f"obstacles of {second}", [(b, "#000000", "obstacle"), (~b, "#dddddd", "ground")]),
        (
            "where they differ",
            [(~(a ^ b), "#dddddd", "same"), (a & ~b, VERMILION, f"only {first}"), (b & ~a, SKY, f"only {second}")],
        ),
    ]
    near = (np.abs(points[:, :2]) < 25).all(axis=1)
    for ax, (title, parts) in zip(axes, layers, strict=True):
        for chosen, colour, name in sorted(parts, key=lambda part: part[1] != "#dddddd"):
            x, y = points[near & chosen, 0], points[near & chosen, 1]
            ax.plot(x, y, ".", ms=0.6, mew=0, color=colour, rasterized=True)  # as dots a PDF would hold a megabyte
            ax.plot([], [], "s", ms=4, color=colour, label=f"{name} ({np.count_nonzero(near & chosen):,})")
        ax.set_title(title, fontsize=TEXT)
        ax.set_xlabel("forward (m)", fontsize=TEXT)
        ax.tick_params(labelsize=SMALL)
        ax.set_aspect("equal")
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), fontsize=SMALL, frameon=False)
    axes[0].set_ylabel("left (m)", fontsize=TEXT)
    return fig
