"""Pictures of velocities: the direction as a colour of the wheel in the corner, the brighter the faster.

What stands is black, as occupied cells are drawn everywhere; only cells that the filter finds to move have a colour.
"""

from typing import cast

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import hsv_to_rgb, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image

from envpred.horizons import in_seconds, shown_steps
from envpred.mapping.dogma import moving_velocity
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN, heading_of
from envpred.pictures.grids import LABEL_COLOURS, SINGLE, SMALL, TEXT, draw_grid, figure, gif
from envpred.pictures.panels import metres
from envpred.store import StoredDrive

FASTEST = 12.0  # m/s; what is faster has the colour of the wheel's rim
EGO_COLOUR = "#777777"  # a grey, as colours mean directions here
EGO_ARROW = np.array([[2.2, 0.0], [-1.2, 1.1], [-0.6, 0.0], [-1.2, -1.1]])  # m, ahead and to the left

Picture = NDArray[np.float32]  # (H, W, 3) colours in [0, 1], first axis east
Moving = tuple[NDArray[np.floating], NDArray[np.floating]]  # probability of occupied (..., H, W), m/s (..., 2, H, W)


def colour_of(velocity: NDArray[np.floating]) -> Picture:
    """Colours (H, W, 3) of `velocity` (2, H, W) in m/s: hue for the direction (red is east), black for 0."""
    hue = np.arctan2(velocity[1], velocity[0]) / (2 * np.pi) % 1
    speed = np.hypot(*velocity)
    # Slow movers must differ from what stands, so brightness starts at a third.
    value = np.where(speed > 0, 0.35 + 0.65 * np.clip(speed / FASTEST, 0, 1), 0)
    return np.asarray(hsv_to_rgb(np.stack((hue, np.ones_like(hue), value), axis=-1)), np.float32)


def over_labels(labels: NDArray[np.uint8], velocity: NDArray[np.floating]) -> Picture:
    """The label grid (H, W) with its occupied cells in the colours of their `velocity` (2, H, W)."""
    colours = {**LABEL_COLOURS, EGO: EGO_COLOUR}
    picture = np.array([to_rgb(colours[code]) for code in (UNKNOWN, OCCUPIED, FREE, EGO)], np.float32)
    ordered = picture[np.argsort((UNKNOWN, OCCUPIED, FREE, EGO))][labels]
    return np.where((labels == OCCUPIED)[..., None], colour_of(velocity), ordered)


def over_occupancy(probability: NDArray[np.floating], velocity: NDArray[np.floating]) -> Picture:
    """The probability of occupied (H, W) in grey, its moving cells in the colours of their `velocity` (2, H, W)."""
    p = np.clip(probability, 0, 1)[..., None]
    return np.asarray((1 - p) + p * colour_of(velocity), np.float32)


def draw_wheel(ax: Axes, size: float = 0.26) -> None:
    """The colour wheel in the lower left corner of `ax`, as wide as `size` of it."""
    at = np.linspace(-1, 1, 121)
    disc = np.stack(np.meshgrid(at, at, indexing="ij"))
    alpha = (np.hypot(*disc) <= 1).astype(np.float32)[..., None]
    wheel = ax.inset_axes((0.01, 0.01, size, size))
    wheel.imshow(
        np.concatenate((colour_of(FASTEST * disc), alpha), -1).transpose(1, 0, 2), origin="lower", extent=(-1, 1, -1, 1)
    )
    wheel.set_axis_off()
    wheel.set(xlim=(-1.45, 1.45), ylim=(-1.45, 1.45))
    for text, x, y in (("E", 1.2, 0), ("N", 0, 1.2), ("W", -1.2, 0), ("S", 0, -1.2)):
        wheel.text(x, y, text, ha="center", va="center", fontsize=SMALL)
    wheel.text(0, 0, f"{FASTEST:.0f} m/s\nat the rim", ha="center", va="center", fontsize=SMALL, color="white")


def draw_picture(ax: Axes, picture: Picture, resolution: float, heading: float | None = None) -> tuple[Artist, Artist]:
    """Draw colours (H, W, 3) of cells of `resolution` metres as a map, with the ego at its centre.

    The ego is an arrow along `heading` (radians), or a dot where none is given.
    """
    image = draw_grid(ax, picture[..., 0], resolution)
    image.set_data(picture.transpose(1, 0, 2))
    if heading is None:
        return image, ax.plot(0, 0, "o", color="white", markeredgecolor="black", markersize=5)[0]
    cos, sin = np.cos(heading), np.sin(heading)
    corners = EGO_ARROW @ np.array([[cos, sin], [-sin, cos]])
    return image, ax.add_patch(Polygon(corners, facecolor="white", edgecolor="black", linewidth=1, zorder=3))


def of_frame(drive: StoredDrive, frame: int) -> Figure:
    """One frame of a stored drive: its label grid with the moving cells in the colours of their velocity.

    Raises:
        UserError: if the drive has no velocities.
    """
    ax = _framed()
    picture, heading = _stored(drive, frame)
    draw_picture(ax, picture, drive.manifest["lattice"]["resolution"], heading)
    ax.set_title(f"{drive.name}, frame {drive.frames[frame]}", fontsize=TEXT)
    return cast(Figure, ax.figure)


def of_drive(drive: StoredDrive) -> bytes:
    """A GIF of a whole stored drive at its own pace, every frame as `of_frame` draws it.

    Raises:
        UserError: if the drive has no velocities.
    """
    ax = _framed()
    canvas = FigureCanvasAgg(cast(Figure, ax.figure))

    def frame(t: int) -> Image.Image:
        picture, heading = _stored(drive, t)
        artists = draw_picture(ax, picture, drive.manifest["lattice"]["resolution"], heading)
        ax.set_title(f"{drive.name}, frame {drive.frames[t]}", fontsize=TEXT)
        canvas.draw()  # type: ignore[no-untyped-call]
        shown = np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
        for artist in artists:
            artist.remove()
        return Image.fromarray(shown.copy()).quantize(256)

    return gif(frame, range(len(drive.frames)), drive.period)


def velocity_strip(
    shown: Moving, target: Moving, forecast: Moving | None, resolution: float, period: float, title: str = ""
) -> Figure:
    """The last frame shown, then targets over forecasts at the paper's horizons, all with velocities.

    Args:
        shown: probability of occupied (H, W) and velocity (2, H, W) in m/s of the last frame shown.
        target: those of the frames after it, (N, H, W) and (N, 2, H, W).
        forecast: the same as forecast; None of a forecaster of occupancy alone.
        resolution: side of a cell in metres.
        period: seconds between frames.
        title: of the whole.
    """
    chosen = shown_steps(len(target[0]), period)
    rows = [("target", target)] + ([("forecast", forecast)] if forecast is not None else [])
    width, height = 2.3 * (len(chosen) + 1) + 0.9, 2.3 * len(rows) + 0.9
    # Placed by hand, as in `panels`.
    fig = figure(width, height, layout=None)
    axes = fig.subplots(len(rows), len(chosen) + 1, sharex=True, sharey=True, squeeze=False)
    fig.subplots_adjust(0.75 / width, 0.5 / height, 1 - 0.1 / width, 1 - 0.55 / height, 0.06, 0.06)
    for row, (name, (probability, velocity)) in enumerate(rows):
        axes[row, min(row, 1)].set_ylabel(f"{name}\nnorth (m)", fontsize=8)
        for ax, h in zip(axes[row, 1:], chosen, strict=True):
            draw_picture(ax, over_occupancy(probability[h - 1], velocity[h - 1]), resolution)
            if row == 0:
                ax.set_title(in_seconds(h * period), fontsize=9)
    draw_picture(axes[0, 0], over_occupancy(*shown), resolution)
    axes[0, 0].set_title("last frame shown", fontsize=9)
    draw_wheel(axes[0, 0], 0.36)
    for ax in axes[1:, 0]:
        ax.set_axis_off()
    for ax in axes[-1]:
        ax.set_xlabel("east (m)", fontsize=8)
    for ax in axes.flat:
        ax.tick_params(labelsize=7)
    fig.suptitle(title, fontsize=9)
    return fig


def _stored(drive: StoredDrive, t: int) -> tuple[Picture, float]:
    """The picture of the frame at position `t` of a stored drive, and the ego's heading."""
    labels = np.array(drive.array("label")[t])
    velocity, covariance = (torch.from_numpy(np.array(drive.array(name)[t])) for name in ("velocity", "velocity_cov"))
    moving = moving_velocity(velocity, covariance).numpy()
    return over_labels(labels, moving), float(heading_of(np.array(drive.array("pose")[t])))


def _framed(size: float = SINGLE) -> Axes:
    """Axes in metres in a figure of their own, `size` inches wide, with the wheel."""
    fig = figure(size, size, layout=None)
    ax = fig.add_axes((0.14, 0.12, 0.84, 0.81))
    ax.set_xlabel("east (m)", fontsize=TEXT)
    ax.set_ylabel("north (m)", fontsize=TEXT)
    ax.tick_params(labelsize=SMALL)
    ax.xaxis.set_major_locator(metres())
    ax.yaxis.set_major_locator(metres())
    draw_wheel(ax, 0.32)
    return ax
