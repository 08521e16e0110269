"""Pictures of simulated drives: a scan coloured by class, the traffic of a town from above."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from envpred.drives.drive import read_points
from envpred.errors import UserError
from envpred.simulate import classes
from envpred.simulate.mesh import FloatArray
from envpred.simulate.traffic import KINDS, LANES, RATE, Recording

_SHADES = {
    "driving": "#8c8c94", "junction": "#8c8c94", "parking": "#a9a9b3", "cycleway": "#b58a83", "sidewalk": "#cfcac0",
    "crossing": "#f2f2f2", "walkingarea": "#cfcac0",
}  # fmt: skip
_LEGEND = {
    "road": (classes.ROAD,),
    "pavement": (classes.SIDEWALK,),
    "parking": (classes.PARKING,),
    "grass": (classes.TERRAIN,),
    "building": (classes.BUILDING,),
    "wall, fence": (classes.FENCE, classes.OTHER_STRUCTURE),
    "plants": (classes.VEGETATION,),
    "pole": (classes.POLE,),
    "car": (classes.CAR, classes.MOVING_CAR),
    "van": (classes.OTHER_VEHICLE, classes.MOVING_OTHER),
    "truck": (classes.TRUCK, classes.MOVING_TRUCK),
    "bicycle": (classes.BICYCLIST, classes.MOVING_BICYCLIST, classes.BICYCLE),
    "person": (classes.PERSON, classes.MOVING_PERSON),
}
_USERS = {"car": "#1f4e9c", "van": "#4a2d83", "truck": "#22223b", "bicycle": "#d81b8c", "person": "#e3170a"}


def scan_picture(drive: Path, frame: int, reach: float = 45.0) -> Figure:
    """A scan of a simulated drive, obliquely from behind and above, coloured by class (SemanticKITTI's colours).

    Raises:
        UserError: if the drive has no such frame, or no labels.
    """
    points = read_points(drive / "velodyne_points" / "data" / f"{frame:010d}.bin")
    file = drive / "labels" / f"{frame:010d}.label"
    if not file.is_file():
        raise UserError(f"{file}: no such labels; only drives of `envpred simulate` know the class of every point")
    words = np.fromfile(file, np.uint32)
    if len(words) != len(points):
        raise UserError(
            f"{file}: {len(words)} labels of {len(points)} points; copy it again, or simulate the drive anew"
        )
    seen = classes.semantic(words)
    colours = np.full((65536, 3), 0.6)
    for number, colour in classes.COLOURS.items():
        colours[number] = np.array(colour) / 255
    across, up, depth = _project(points[:, :3].astype(np.float64))
    drawn = (depth > 1) & (np.abs(points[:, :2]).max(axis=1) < reach)
    order = np.flatnonzero(drawn)[np.argsort(-depth[drawn])]
    figure, axes = plt.subplots(figsize=(12, 5.4), facecolor="black")
    axes.scatter(
        across[order],
        up[order],
        s=24 / depth[order],
        c=colours[seen[order]],
        linewidths=0,
        rasterized=True,
    )
    axes.set(xlim=(-0.95, 0.95), ylim=(-0.62, 0.235), aspect="equal", facecolor="black")
    axes.axis("off")
    for name, members in _LEGEND.items():
        if np.isin(seen, members).any():
            axes.scatter([], [], s=30, color=np.array(classes.COLOURS[members[0]]) / 255, label=name)
    axes.legend(loc="lower center", ncols=len(_LEGEND), fontsize="small", labelcolor="white", facecolor="black")
    figure.subplots_adjust(0, 0, 1, 1)
    return figure


def _project(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pinhole view from 22 m behind and 13 m above the sensor, 24 degrees down: right, up, depth."""
    away = points - np.array([-22.0, 0.0, 13.0])
    c, s = np.cos(np.radians(24)), np.sin(np.radians(24))
    depth = c * away[:, 0] - s * away[:, 2]
    safe = np.maximum(depth, 0.1)
    return -away[:, 1] / safe, (s * away[:, 0] + c * away[:, 2]) / safe, depth


def traffic_picture(recording: Recording, network: int, second: float, reach: float = 110.0) -> Figure:
    """The streets of a town and everybody on them at a moment of the recording, each with the path of 3 s to come.

    The picture shows `reach` metres around the middle of the traffic.
    """
    figure, axes = plt.subplots(figsize=(9, 8))
    town = recording.networks[network]
    for outline in town.junctions:
        axes.add_patch(Polygon(outline, color=_SHADES["sidewalk"], lw=0, zorder=0))
    order = ("sidewalk", "walkingarea", "parking", "cycleway", "junction", "driving", "crossing")
    for kind, width, line in sorted(town.lanes, key=lambda lane: order.index(LANES[lane[0]])):
        if LANES[kind] == "walkingarea":
            continue
        outline = _widened(line, width)
        axes.add_patch(Polygon(outline, color=_SHADES[LANES[kind]], lw=0, zorder=1 + order.index(LANES[kind])))
    now = round(second * RATE)
    shown: set[str] = set()
    present = [(m, now - m.first) for m in recording.motions(network) if 0 <= now - m.first < len(m.heading)]
    middle = np.median([m.centre[k] for m, k in present], axis=0) if present else np.zeros(2)
    for motion, k in present:
        user = KINDS[motion.kind]
        corners = _corners(motion.centre[k], motion.heading[k], max(motion.length, 1.2), max(motion.width, 0.9))
        name = None if user in shown else user
        axes.add_patch(Polygon(corners, color=_USERS[user], lw=0, zorder=12, label=name))
        axes.plot(*motion.centre[k : k + 31].T, color=_USERS[user], lw=1.0, alpha=0.6, zorder=11)
        shown.add(user)
    (left, right), (low, high) = (middle[axis] + np.array([-reach, reach]) for axis in (0, 1))
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal", title=f"{town.name}, {second:g} s")
    axes.set(xlabel="east (m)", ylabel="north (m)")
    axes.legend(loc="upper right", ncols=len(shown) or 1, fontsize="small").set_zorder(20)  # above the streets
    figure.tight_layout()
    return figure


def _widened(line: FloatArray, width: float) -> FloatArray:
    """Outline (2 n, 2) of a line of a width."""
    along = np.gradient(line, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1) * width / 2
    return np.concatenate([line + aside, (line - aside)[::-1]])


def _corners(centre: FloatArray, heading: float, length: float, width: float) -> NDArray[np.float64]:
    c, s = np.cos(heading), np.sin(heading)
    box = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    corners: NDArray[np.float64] = centre + box @ np.array([[c, s], [-s, c]])
    return corners
