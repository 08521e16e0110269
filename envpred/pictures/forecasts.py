"""Pictures of forecasts over the horizon, as strips: one method with its errors, or several beside each other.

Circles are sky blue around the ego and vermilion around what moves, and the panels of an oracle have purple frames:
colours of Okabe and Ito, on maps in grey.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from envpred.horizons import in_seconds
from envpred.pictures.grids import SKY, SMALL, TEXT, VERMILION, draw_grid
from envpred.pictures.panels import (
    blank,
    colour_bar,
    draw_circled,
    draw_context,
    entitle,
    label_rows,
    mark_oracle,
    metres,
    panels,
)
from envpred.results.scenes import Scene

TARGET = "target"
MOST = 5  # methods in a strip that fits on a page
Camera = Callable[[int], Path | None]  # frame -> the file of its picture, if there is one


def forecast_strip(scene: Scene, title: str | None = None) -> Figure:
    """Targets over forecasts over their error of the first method of a `scene`, at the horizons that have a target."""
    forecast = next(iter(scene.forecasts.values()))
    shown = [h for h in scene.shown if h <= min(len(scene.target), len(forecast))]
    fig, axes = panels(len(shown), 3)
    for column, h in enumerate(shown):
        truth, guess = scene.target[h - 1], forecast[h - 1]
        black = draw_grid(axes[0][column], truth, scene.resolution, cmap="gray_r", vmin=0, vmax=1)
        draw_grid(axes[1][column], guess, scene.resolution, cmap="gray_r", vmin=0, vmax=1)
        error = draw_grid(axes[2][column], guess - truth, scene.resolution, cmap="PuOr", vmin=-1, vmax=1)
        axes[0][column].set_title(in_seconds(h * scene.period), fontsize=TEXT, pad=3)
        axes[2][column].set_xlabel(f"MSE {np.mean((guess - truth) ** 2):.4f}", fontsize=SMALL, labelpad=2)
    label_rows(axes, [TARGET, "forecast", "forecast - target"])
    if scene.oracles:
        mark_oracle(axes[1])
    colour_bar(axes[1][-1], black, "probability of occupied")
    colour_bar(axes[2][-1], error, "error")
    entitle(fig, scene.where if title is None else title)
    return fig


def scene_parts(scene: Scene) -> list[Scene]:
    """The scene, or several of some of its methods each, whose strips are no longer than a page."""
    methods = list(scene.forecasts)
    number = -(-len(methods) // MOST)
    size = -(-len(methods) // number)
    parts = [methods[n : n + size] for n in range(0, len(methods), size)]
    return [replace(scene, forecasts={name: scene.forecasts[name] for name in part}) for part in parts]


def scene_strip(
    scene: Scene,
    horizons: Sequence[int] | None = None,
    camera: Camera | None = None,
    title: str | None = None,
    circles: bool = True,
) -> Figure:
    """The paper's results figure: camera, target and each method's forecast, the last frame shown before them.

    What was seen of the wider grid stands below that frame, where the scene has it.

    Args:
        scene: the window; without frames shown there is neither their column nor a row of targets.
        horizons: the columns (1 is the first step), by default the paper's and the last if that lies beyond them.
        camera: tells the file of the picture of a frame, if there are any.
        title: of the whole, by default drive and frame.
        circles: circle the ego and what moves.
    """
    shown = list(scene.shown if horizons is None else [h for h in horizons if h <= scene.horizons])
    columns = ([0] if len(scene.seen) else []) + shown
    files = [camera and camera(scene.frames[-1] + h) for h in columns]
    pictures = [None if file is None else np.asarray(Image.open(file)) for file in files]
    ratios = [picture.shape[0] / picture.shape[1] for picture in pictures if picture is not None]
    rows = {**({TARGET: scene.target} if len(scene.seen) or len(scene.target) else {}), **scene.forecasts}
    apart = scene.context is not None and len(scene.seen) > 0
    fig, axes = panels(len(columns), len(rows), max(ratios, default=0.0), apart)
    for ax, picture in zip(axes[0], pictures, strict=False):
        if picture is not None:
            ax.imshow(picture, cmap="gray", aspect="auto")
    maps = axes[bool(ratios) :]
    first = len(columns) - len(shown)
    if first:
        axes[0][0].set_title(f"{in_seconds(0)}, seen", fontsize=TEXT, pad=3)
        _draw_seen([row[0] for row in maps], scene, circles)
    moving = False
    for column, h in enumerate(shown, first):
        axes[0][column].set_title(in_seconds(h * scene.period), fontsize=TEXT, pad=3)
        marks = scene.movers(h)
        moving |= bool(marks)
        for ax, (name, grids) in zip([row[column] for row in maps], rows.items(), strict=True):
            if h > len(grids):
                blank(ax, "no target" if name == TARGET else "not forecast")
                continue
            image = draw_circled(ax, grids[h - 1], scene.resolution, marks, circles)
            if name != TARGET and h <= len(scene.target):
                ax.set_xlabel(
                    f"MSE {np.mean((grids[h - 1] - scene.target[h - 1]) ** 2):.4f}", fontsize=SMALL, labelpad=2
                )
    label_rows([row[apart:] for row in maps], list(rows))
    for name, row in zip(rows, maps, strict=True):
        if name in scene.oracles:
            mark_oracle(row[first:])
    colour_bar(maps[-1][-1], image, "probability of occupied")
    colours = {"ego": SKY} | ({"moving": VERMILION} if moving else {}) if circles else {}
    keys = [Line2D([], [], marker="o", ls="", mfc="none", mec=colour, label=name) for name, colour in colours.items()]
    if keys:
        fig.legend(handles=keys, loc="lower right", fontsize=SMALL, ncols=2, frameon=False)
    entitle(fig, scene.where if title is None else title)
    return fig


def _draw_seen(column: Sequence[Axes], scene: Scene, circles: bool) -> None:
    """The last frame shown, and below it the wider grid, if there is one."""
    draw_circled(column[0], scene.seen[-1], scene.resolution, circles=circles)
    used = 1
    if scene.context is not None:
        used = 2
        draw_context(column[1], scene.context, scene.seen.shape[-1], scene.resolution, circles)
        for ax in column[:used]:
            ax.set_ylabel("north (m)", fontsize=SMALL)
            ax.yaxis.set_major_locator(metres())
        column[1].xaxis.set_major_locator(metres())
        column[1].set_xlabel("east (m)", fontsize=SMALL)
    for ax in column[used:]:
        ax.set_axis_off()
