"""Rows of map panels: how the strips of forecasts are laid out.

Placed by hand and without ticks between: for that many panels matplotlib's automatic layout takes seconds, ticks half
one.
"""

import textwrap
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator, NullLocator

from envpred.pictures.grids import DOUBLE, PURPLE, SKY, SMALL, TEXT, VERMILION, Grid, draw_grid, edges, figure
from envpred.results.movers import Mover

EGO_CIRCLE = 3.5  # m; the ego's body and a little more
LARGEST, LONGEST = 2.2, 9.3  # inches; the side of a panel however few there are, and all of them, on a page
LINE = 20  # letters of a row's name that the height of a panel holds


def panels(columns: int, rows: int, camera: float = 0.0, apart: bool = False) -> tuple[Figure, list[list[Axes]]]:
    """A figure of rows of square panels, as wide as two columns of a paper.

    Args:
        columns: of panels.
        rows: of panels.
        camera: height over width of a row of camera pictures above them, 0 for none.
        apart: leave room for the names of rows after the first column.
    """
    width, between, gap, left, right, top, bottom = DOUBLE, 0.05, 0.2, 0.68, 0.72, 0.5, 0.62  # inches
    across = (width - left * (1 + apart) - right - between * (columns - 1)) / columns
    gaps = gap * (rows + bool(camera) - 1)
    side = min(LARGEST, across, (LONGEST - top - bottom - gaps) / (rows + camera))
    heights = [side * camera] * bool(camera) + [side] * rows
    west = [left + c * (side + between) + left * (apart and c > 0) for c in range(columns)]
    height = top + sum(heights) + gaps + bottom
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
        ax.tick_params(labelsize=SMALL)
        ax.xaxis.set_major_locator(NullLocator())
        ax.yaxis.set_major_locator(NullLocator())
    return fig, found


def metres() -> MaxNLocator:
    """Few ticks at round numbers."""
    return MaxNLocator(4, steps=[1, 2, 5, 10])


def draw_circled(
    ax: Axes, grid: Grid, resolution: float, marks: Sequence[Mover] = (), circles: bool = True
) -> AxesImage:
    """An occupancy grid with the ego, at its centre, and `marks`, in its cells, circled; without `circles` neither."""
    image = draw_grid(ax, grid, resolution, cmap="gray_r", vmin=0, vmax=1)
    ax.autoscale(False)
    if not circles:
        return image
    ax.add_patch(Circle((0, 0), EGO_CIRCLE, fill=False, color=SKY, linewidth=1))
    half = grid.shape[0] // 2
    for mark in marks:
        centre = ((mark.i - half) * resolution, (mark.j - half) * resolution)
        ax.add_patch(Circle(centre, mark.radius * resolution, fill=False, color=VERMILION, linewidth=1))
    return image


def draw_context(ax: Axes, context: Grid, cells: int, resolution: float, circles: bool = True) -> None:
    """The wider grid around the judged one of so many `cells` a side, which is outlined."""
    draw_circled(ax, context, resolution, circles=circles)
    low, high = edges(cells, resolution)
    ax.add_patch(Rectangle((low, low), high - low, high - low, fill=False, color=SKY, linewidth=1, linestyle="--"))
    ax.set_title(f"context, {context.shape[0] * resolution:.0f} m wide", fontsize=SMALL, pad=2)


def blank(ax: Axes, why: str) -> None:
    """A panel without a grid, and why."""
    ax.set_facecolor("#eeeeee")
    ax.text(0.5, 0.5, why, ha="center", va="center", transform=ax.transAxes, fontsize=TEXT, color="#555555")


def label_rows(axes: Sequence[Sequence[Axes]], names: Sequence[str]) -> None:
    """Names of the rows, and metres at the left of each and below the first column."""
    for row, name in zip(axes, names, strict=True):
        first = next(ax for ax in row if ax.axison)
        first.set_ylabel("\n".join([*wrapped(name), "north (m)"]), fontsize=SMALL, parse_math=False)
        first.yaxis.set_major_locator(metres())
    first = next(ax for ax in axes[-1] if ax.axison)  # those of all would run into each other
    first.set_xlabel(f"{first.get_xlabel()}\neast (m)".strip(), fontsize=SMALL)
    first.xaxis.set_major_locator(metres())


def wrapped(name: str) -> list[str]:
    """A method's name in lines: where its commas are, if the height of a panel does not hold it."""
    if len(name) <= LINE:
        return [name]
    return [line for part in name.replace(", ", ",\n").split("\n") for line in textwrap.wrap(part, LINE)]


def mark_oracle(row: Sequence[Axes]) -> None:
    """Say of a row of panels that its forecasts read the future: dashed purple frames, and a word."""
    for ax in row:
        for spine in ax.spines.values():
            spine.set(color=PURPLE, linewidth=1.6, linestyle=(0, (3, 2)))
    box = {"facecolor": "white", "edgecolor": PURPLE, "pad": 1.5}
    row[0].text(0.04, 0.04, "reads the future", transform=row[0].transAxes, fontsize=SMALL, bbox=box)


def colour_bar(last: Axes, image: AxesImage, name: str) -> None:
    """The scale of an `image`'s colours, at the right of the `last` panel of its row."""
    fig, place = last.figure.canvas.figure, last.get_position()  # also of a panel in a subfigure
    inch = 1 / fig.get_figwidth()
    bar = fig.add_axes((place.x1 + 0.07 * inch, place.y0, 0.09 * inch, place.height))
    fig.colorbar(image, cax=bar)
    bar.set_ylabel("\n".join(wrapped(name)), fontsize=SMALL)
    bar.tick_params(labelsize=SMALL)


def entitle(fig: Figure, title: str) -> None:
    """The title of a figure of panels."""
    fig.suptitle(title, fontsize=TEXT, y=1 - 0.08 / fig.get_figheight(), va="top")
