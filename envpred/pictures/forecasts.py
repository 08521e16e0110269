"""Pictures of forecasts: strips over the horizon, and animations.

Circles are sky blue around the ego and vermilion around what moves, and an animation has an orange rim around what is
forecast: colours of Okabe and Ito, on maps in grey.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from envpred.horizons import PERIOD, SHOWN_HORIZONS
from envpred.mapping.geometry import GridSpec
from envpred.pictures.grids import SKY, VERMILION, Grid, draw_grid, figure, gif
from envpred.results.movers import Mover
from envpred.results.scenes import Scene

EGO_CIRCLE = 3.5  # m; the ego's body and a little more
# An animation's palette: greys from black to white, and the orange of what is forecast.
BLACK, RIM, PALE, WHITE, FORECAST_RIM = 0, 148, 227, 252, 254
GREYS = [value for grey in range(WHITE + 1) for value in [round(255 * grey / WHITE)] * 3]
PALETTE = [*GREYS, 0, 0, 0, 230, 159, 0, 0, 0, 0]
SHADES = 36  # of a map in an animation; more make files grow and nobody sees them


def scene_strip(
    scene: Scene,
    horizons: Sequence[int] | None = None,
    camera: Callable[[int], Path | None] = lambda frame: None,
    title: str | None = None,
) -> Figure:
    """The strip of a `scene` at some `horizons`, by default the paper's and the last if that lies beyond them.

    `camera` tells the file of the picture of a frame, if there is one.
    """
    if horizons is None:
        within = [h for h in SHOWN_HORIZONS if h <= scene.horizons]
        beyond = scene.horizons > SHOWN_HORIZONS[-1] or not within
        horizons = [*within, scene.horizons] if beyond else within
    now = scene.seen[-1] if len(scene.seen) else None
    columns = ([0] if now is not None else []) + list(horizons)
    files = [camera(scene.frames[-1] + h) for h in columns]
    pictures = [None if file is None else np.asarray(Image.open(file)) for file in files]
    return comparison_strip(
        scene.target,
        scene.forecasts,
        horizons,
        pictures,
        [scene.movers(h) for h in horizons],
        scene.where if title is None else title,
        now,
    )


def scene_animation(scene: Scene) -> bytes:
    """A GIF that plays a `scene`."""
    return animation(scene.seen, scene.target, scene.forecasts, scene.where)


def forecast_strip(target: Grid, forecast: Grid, horizons: Sequence[int], title: str = "") -> Figure:
    """Targets over forecasts over their error at some `horizons` (1 is the first), each (N, H, W)."""
    shown = [h for h in horizons if h <= len(target)]
    fig, axes = _panels(len(shown), 3)
    for column, h in enumerate(shown):
        truth, guess = target[h - 1], forecast[h - 1]
        black = draw_grid(axes[0][column], truth, cmap="gray_r", vmin=0, vmax=1)
        draw_grid(axes[1][column], guess, cmap="gray_r", vmin=0, vmax=1)
        error = draw_grid(axes[2][column], guess - truth, cmap="PuOr", vmin=-1, vmax=1)
        axes[0][column].set_title(_seconds(h))
        axes[2][column].set_xlabel(f"MSE {np.mean((guess - truth) ** 2):.4f}", fontsize=8)
    _label(axes, ["target", "forecast", "forecast - target"])
    _bar(axes[1][-1], black, "probability of occupied")
    _bar(axes[2][-1], error, "error")
    _title(fig, title)
    return fig


def comparison_strip(
    target: Grid,
    forecasts: Mapping[str, Grid],
    horizons: Sequence[int],
    pictures: Sequence[NDArray[np.uint8] | None] = (),
    circled: Sequence[Sequence[Mover]] = (),
    title: str = "",
    now: Grid | None = None,
) -> Figure:
    """The paper's results figure: camera, target and each method's forecast at some `horizons` (1 is the first).

    Args:
        target: (n, H, W), as far as there are targets; may be empty.
        forecasts: (N, H, W) by method.
        horizons: the columns.
        pictures: of the camera, (h, w) or (h, w, 3), one a column (that of `now` too) or None where there is none.
        circled: what to point at in each column, in vermilion; the ego, at the centre, always is, in blue.
        title: of the whole.
        now: the last frame shown (H, W), drawn before the others.
    """
    shown = [h for h in horizons if h <= max(len(grid) for grid in forecasts.values())]
    first = int(now is not None)
    rows = {**({"target": target} if len(target) or first else {}), **forecasts}
    ratios = [picture.shape[0] / picture.shape[1] for picture in pictures if picture is not None]
    fig, axes = _panels(first + len(shown), len(rows), max(ratios, default=0.0))
    for ax, picture in zip(axes[0], pictures, strict=False):
        if picture is not None:
            ax.imshow(picture, cmap="gray", aspect="auto")
    for column, h in enumerate(shown):
        axes[0][first + column].set_title(_seconds(h))
        marks = circled[column] if column < len(circled) else ()
        for row, (name, grids) in zip(axes[bool(ratios) :], rows.items(), strict=True):
            if h > len(grids):
                _blank(row[first + column], "no target" if name == "target" else "not forecast")
                continue
            _draw(row[first + column], grids[h - 1], marks)
            if name != "target" and h <= len(target):
                error = np.mean((grids[h - 1] - target[h - 1]) ** 2)
                row[first + column].set_xlabel(f"MSE {error:.4f}", fontsize=8)
    if now is not None:
        axes[0][0].set_title(f"{_seconds(0)}, seen")
        here = axes[bool(ratios)][0]
        _draw(here, now, ())
        here.set_xlabel("east (m)", fontsize=8)
        here.xaxis.set_major_locator(_metres())
        for row in axes[bool(ratios) + 1 :]:
            row[0].set_axis_off()
    _label(axes[bool(ratios) :], list(rows))
    _bar(
        axes[-1][-1],
        next(ax.images[0] for row in axes[bool(ratios) :] for ax in row if ax.images),
        "probability of occupied",
    )
    circles = {"ego": SKY} | ({"moving": VERMILION} if any(circled) else {})
    keys = [Line2D([], [], marker="o", ls="", mfc="none", mec=colour, label=name) for name, colour in circles.items()]
    fig.legend(handles=keys, loc="lower right", fontsize=8, ncols=2, frameon=False)
    _title(fig, title)
    return fig


def _panels(columns: int, rows: int, camera: float = 0.0) -> tuple[Figure, list[list[Axes]]]:
    """A figure of rows of square panels, above them camera pictures, so many times their width in height (0: none).

    Placed by hand and without ticks: for that many panels matplotlib's automatic layout takes seconds, ticks half one.
    """
    side, gap, left, right, top, bottom = 1.9, 0.32, 0.95, 0.95, 0.65, 0.8  # inches
    heights = [side * camera] * bool(camera) + [side] * rows
    width = left + columns * (side + 0.1) + right
    height = top + sum(heights) + gap * (len(heights) - 1) + bottom
    fig = figure(width, height, layout=None)
    panels, y = [], height - top
    for h in heights:
        y -= h
        places = [((left + c * (side + 0.1)) / width, y / height, side / width, h / height) for c in range(columns)]
        panels.append([fig.add_axes(place) for place in places])
        y -= gap
    for ax in panels[0] if camera else ():
        ax.set_axis_off()
    for ax in (ax for row in panels[bool(camera) :] for ax in row):
        ax.tick_params(labelsize=7)
        ax.xaxis.set_major_locator(NullLocator())
        ax.yaxis.set_major_locator(NullLocator())
    return fig, panels


def _seconds(steps: int) -> str:
    return f"{PERIOD * steps:.1f} s"


def _metres() -> MaxNLocator:
    return MaxNLocator(4, steps=[1, 2, 5, 10])


def _draw(ax: Axes, grid: Grid, marks: Sequence[Mover], resolution: float = GridSpec().resolution) -> None:
    """A grid with the ego, at its centre, and `marks`, in its cells, circled."""
    draw_grid(ax, grid, cmap="gray_r", vmin=0, vmax=1)
    ax.autoscale(False)
    ax.add_patch(Circle((0, 0), EGO_CIRCLE, fill=False, color=SKY, linewidth=1.3))
    half = grid.shape[0] // 2
    for mark in marks:
        centre = ((mark.i - half) * resolution, (mark.j - half) * resolution)
        ax.add_patch(Circle(centre, mark.radius * resolution, fill=False, color=VERMILION, linewidth=1.3))


def _blank(ax: Axes, why: str) -> None:
    ax.set_facecolor("#eeeeee")
    ax.text(0.5, 0.5, why, ha="center", va="center", transform=ax.transAxes, fontsize=8, color="#555555")


def _label(axes: Sequence[Sequence[Axes]], names: Sequence[str]) -> None:
    """Names of the rows, and metres at the left and below."""
    for row, name in zip(axes, names, strict=True):
        first = next(ax for ax in row if ax.axison)
        first.set_ylabel("\n(".join(name.split(" (")) + "\nnorth (m)", fontsize=8)
        first.yaxis.set_major_locator(_metres())
    for ax in axes[-1]:
        ax.set_xlabel(f"{ax.get_xlabel()}\neast (m)".strip(), fontsize=8)
        ax.xaxis.set_major_locator(_metres())


def _bar(last: Axes, image: AxesImage, name: str) -> None:
    """The scale of an `image`'s colours, at the right of the `last` panel of its row."""
    fig, place = last.get_figure(root=True), last.get_position()
    assert fig is not None
    inch = 1 / fig.get_figwidth()
    bar = fig.add_axes((place.x1 + 0.15 * inch, place.y0, 0.14 * inch, place.height))
    fig.colorbar(image, cax=bar)
    bar.set_ylabel(name, fontsize=8)
    bar.tick_params(labelsize=7)


def _title(fig: Figure, title: str) -> None:
    fig.suptitle(title, fontsize=10, y=1 - 0.12 / fig.get_figheight(), va="top")


def animation(
    seen: Grid,
    target: Grid,
    forecasts: Mapping[str, Grid],
    title: str = "",
    scale: int = 2,
    milliseconds: int = 200,
    across: int = 4,
    resolution: float = GridSpec().resolution,
) -> bytes:
    """A GIF that plays a window: the target first, beside it each method's forecast, with an orange rim.

    Args:
        seen: frames shown (S, H, W); every tile plays them before the forecasts begin.
        target: the frames after them (n, H, W), as far as there are any.
        forecasts: (N, H, W) by method.
        title: of the whole.
        scale: pixels a cell.
        milliseconds: that a frame stands.
        across: tiles in a row, at most.
        resolution: side of a cell in metres.
    """
    tracks = {**({"target": target} if len(seen) or len(target) else {}), **forecasts}
    height, width = next(iter(forecasts.values())).shape[1:]
    tile = (width * scale, height * scale)
    across = min(across, len(tracks))
    font = ImageFont.load_default(13)
    head, line = 38, 20
    size = (across * (tile[0] + 6) + 6, head + -(-len(tracks) // across) * (tile[1] + line + 6))
    frames = []
    for t in range(-len(seen) + 1, max(len(grids) for grids in forecasts.values()) + 1):
        canvas = Image.new("L", size, WHITE)
        draw = ImageDraw.Draw(canvas)
        draw.text((6, 2), title, BLACK, font)
        draw.text((6, 19), f"{PERIOD * t:+.1f} s  {'forecast' if t > 0 else 'seen'}", BLACK, font)
        metres = 10 / resolution * scale  # pixels of ten metres
        draw.line((size[0] - 6 - metres, 31, size[0] - 6, 31), BLACK, 3)
        draw.text((size[0] - 6 - metres, 12), "10 m", BLACK, font)
        for k, (name, grids) in enumerate(tracks.items()):
            x, y = 6 + k % across * (tile[0] + 6), head + k // across * (tile[1] + line + 6)
            draw.text((x, y + 1), name, BLACK, font)
            grid = seen[t - 1] if t <= 0 else grids[t - 1] if t <= len(grids) else None
            place = (x, y + line)
            if grid is None:
                canvas.paste(PALE, (*place, x + tile[0], y + line + tile[1]))
                draw.text((x + 8, y + line + 8), "no target" if name == "target" else "not forecast", BLACK, font)
            else:
                shade = np.rint(SHADES * (1 - np.clip(grid, 0, 1))) * (WHITE // SHADES)
                grey = shade.astype(np.uint8).T[::-1]  # as a map: north up
                canvas.paste(Image.fromarray(grey.repeat(scale, 0).repeat(scale, 1)), place)
            rim = FORECAST_RIM if t > 0 and name != "target" else RIM
            draw.rectangle((*place, x + tile[0] - 1, y + line + tile[1] - 1), outline=rim, width=3)
        canvas.putpalette(PALETTE)
        frames.append(canvas)
    return gif(frames, milliseconds)
