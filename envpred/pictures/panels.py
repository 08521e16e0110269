"""Rows of map panels: how the strips of forecasts are laid out.

Placed by hand and without ticks between: for that many panels matplotlib's automatic layout takes seconds, ticks half
one.
"""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator, NullLocator

from envpred.pictures.grids import PURPLE, SKY, VERMILION, Grid, draw_grid, edges, figure
from envpred.results.movers import Mover

EGO_CIRCLE = 3.5  # m; the ego's body and a little more


def panels(columns: int, rows: int, camera: float = 0.0, apart: bool = False) -> tuple[Figure, list[list[Axes]]]:
    """A figure of rows of square panels.

    Args:
        columns: of panels.
        rows: of panels.
        camera: height over width of a row of camera pictures above them, 0 for none.
        apart: leave room for the names of rows after the first column.
    """
    side, gap, left, right, top, bottom = 1.9, 0.32, 0.95, 0.95, 0.65, 0.8  # inches
    heights = [side * camera] * bool(camera) + [side] * rows
    west = [left + c * (side + 0.1) + left * (apart and c > 0) for c in range(columns)]
    width = west[-1] + side + 0.1 + right
    height = top + sum(heights) + gap * (len(heights) - 1) + bottom
    fig = figure(width, height, layout=None)
    found, y = [], height - top
    for h in heights:
        y -= h
        places = [(x / width, y / height, side / width, h / height) for x in west]
        found.append([fig.add_axes(place) for place in places])
        y -= gap
    for ax in found[0] if camera else ():
        ax.set_axis_off()
    for ax in (ax for row in found[bool(camera) :] for ax in row):
        ax.tick_params(labelsize=7)
        ax.xaxis.set_major_locator(NullLocator())
        ax.yaxis.set_major_locator(NullLocator())
    return fig, found


def metres() -> MaxNLocator:
    """Few ticks at round numbers."""
    return MaxNLocator(4, steps=[1, 2, 5, 10])


def draw_circled(ax: Axes, grid: Grid, resolution: float, marks: Sequence[Mover] = ()) -> AxesImage:
    """An occupancy grid with the ego, at its centre, and `marks`, in its cells, circled."""
    image = draw_grid(ax, grid, resolution, cmap="gray_r", vmin=0, vmax=1)
    ax.autoscale(False)
    ax.add_patch(Circle((0, 0), EGO_CIRCLE, fill=False, color=SKY, linewidth=1.3))
    half = grid.shape[0] // 2
    for mark in marks:
        centre = ((mark.i - half) * resolution, (mark.j - half) * resolution)
        ax.add_patch(Circle(centre, mark.radius * resolution, fill=False, color=VERMILION, linewidth=1.3))
    return image


def draw_context(ax: Axes, context: Grid, cells: int, resolution: float) -> None:
    """The wider grid around the judged one of so many `cells` a side, which is outlined."""
    draw_circled(ax, context, resolution)
    low, high = edges(cells, resolution)
    ax.add_patch(Rectangle((low, low), high - low, high - low, fill=False, color=SKY, linewidth=1, linestyle="--"))
    ax.set_title(f"context, {context.shape[0] * resolution:.0f} m wide", fontsize=8, pad=3)


def blank(ax: Axes, why: str) -> None:
    """A panel without a grid, and why."""
    ax.set_facecolor("#eeeeee")
    ax.text(0.5, 0.5, why, ha="center", va="center", transform=ax.transAxes, fontsize=8, color="#555555")


def label_rows(axes: Sequence[Sequence[Axes]], names: Sequence[str]) -> None:
    """Names of the rows, and metres at the left and below."""
    for row, name in zip(axes, names, strict=True):
        first = next(ax for ax in row if ax.axison)
        first.set_ylabel("\n(".join(name.split(" (")) + "\nnorth (m)", fontsize=8)
        first.yaxis.set_major_locator(metres())
    for ax in axes[-1]:
        ax.set_xlabel(f"{ax.get_xlabel()}\neast (m)".strip(), fontsize=8)
        ax.xaxis.set_major_locator(metres())


def mark_oracle(row: Sequence[Axes]) -> None:
    """Say of a row of panels that its forecasts read the future: dashed purple frames, and a word."""
    for ax in row:
        for spine in ax.spines.values():
            spine.set(color=PURPLE, linewidth=1.6, linestyle=(0, (3, 2)))
    box = {"facecolor": "white", "edgecolor": PURPLE, "pad": 1.5}
    row[0].text(0.03, 0.03, "oracle: reads the future", transform=row[0].transAxes, fontsize=6.5, bbox=box)


def colour_bar(last: Axes, image: AxesImage, name: str) -> None:
    """The scale of an `image`'s colours, at the right of the `last` panel of its row."""
    fig, place = last.figure.canvas.figure, last.get_position()  # also of a panel in a subfigure
    inch = 1 / fig.get_figwidth()
    bar = fig.add_axes((place.x1 + 0.15 * inch, place.y0, 0.14 * inch, place.height))
    fig.colorbar(image, cax=bar)
    bar.set_ylabel(name, fontsize=8)
    bar.tick_params(labelsize=7)


def entitle(fig: Figure, title: str) -> None:
    """The title of a figure of panels."""
    fig.suptitle(title, fontsize=10, y=1 - 0.12 / fig.get_figheight(), va="top")
