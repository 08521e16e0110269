"""A scan as a check sees it: from above and from the side with its road, and the ego's path by poses and by scans."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from envpred.mapping.geometry import FloatArray
from envpred.mapping.ground_plane import WITHIN, Plane
from envpred.pictures.grids import BLUE, GREEN, GREY, VERMILION, figure

REACH, BELOW, ABOVE = 40.0, -6.0, 8.0  # metres that are drawn
MOST = 40_000  # points


def check_picture(
    points: NDArray[np.float32],
    plane: Plane | None,
    said_height: float,
    paths: tuple[FloatArray, FloatArray] | None,
    title: str,
) -> Figure:
    """One scan in the sensor frame, from above and from the side.

    Args:
        points: (N, >=3) metres, x forward, y left, z up, if axes are right.
        plane: of the road, if one was found.
        said_height: of the sensor above the road, metres.
        paths: places (n, 2) of the ego by scans and by poses, metres, if both could be had.
        title: what is said of the drive.
    """
    points = points[:: -(-len(points) // MOST), :3].astype(np.float64)
    road = np.zeros(len(points), np.bool_)
    if plane is not None:
        road = np.abs(points @ plane.normal + plane.distance) < 2 * WITHIN
    fig = figure(12, 5.6)
    above, side, path = fig.subplot_mosaic([["above", "side"], ["above", "path"]]).values()
    for kind, colour, name in ((~road, GREY, "what stands up"), (road, GREEN, "road")):
        above.plot(points[kind, 0], points[kind, 1], ".", color=colour, markersize=1)
        side.plot(points[kind, 0], points[kind, 2], ".", color=colour, markersize=1)
        above.plot([], [], "s", color=colour, label=name)
    above.plot(0, 0, "^", color=VERMILION, label="sensor")
    side.plot(0, 0, "^", color=VERMILION)
    side.axhline(-said_height, color=VERMILION, linewidth=0.8, linestyle="--", label="road as said")
    above.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", title="from above", xlabel="x (m)")
    above.set_ylabel("y (m)")
    side.set(xlim=(-REACH, REACH), ylim=(BELOW, ABOVE), title="from the side", xlabel="x (m)", ylabel="z (m)")
    above.legend(loc="upper right", fontsize=7)
    side.legend(loc="upper right", fontsize=7)
    path.set(title="the ego's path", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    path.set_adjustable("datalim")
    for places, colour, name in zip(paths or (), (BLUE, VERMILION), ("by scans", "by poses"), strict=False):
        path.plot(*places.T, ".-", color=colour, markersize=3, linewidth=0.8, label=name)
    if paths is not None:
        path.legend(loc="best", fontsize=7)
    fig.suptitle(title, fontsize=9, wrap=True)
    return fig
