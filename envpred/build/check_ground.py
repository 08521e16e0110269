"""Where the road lies in the scans: none, above the sensor, beside it, tilted, or at another height than is said."""

from collections import Counter
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.build.findings import Finding, Settings
from envpred.mapping.geometry import FloatArray
from envpred.mapping.ground_plane import Plane, widest_plane

LEAST_SHARE = 0.1  # of the voxels around the sensor that the road covers
MOST_BEYOND = 0.25  # of as many as it covers that lie below it
HEIGHTS = (0.3, 5.0)  # metres of a sensor above its road
MOST_TILT = np.radians(5.0)
ODD_HEIGHT = 0.4  # metres by which the height may differ from what is said
MAJORITY = 0.6  # of the scans looked at
NAMES = ("x", "y", "z")
SQUARE = [  # the 24 rotations by right angles
    turned
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turned := np.diag(signs)[list(order)]) > 0
]


class GroundFound(NamedTuple):
    """The road.

    Args:
        level: (3, 3) from the sensor frame to one whose z points up.
        height: of the sensor above the road, metres; as is said where no road was found.
        scan: place of one of the scans in which it was looked for.
        plane: of the road in that scan, in the sensor frame, if it was found.
    """

    level: FloatArray
    height: float
    scan: int
    plane: Plane | None


def ground_of(
    scans: list[NDArray[np.float32]], said_height: float, settings: Settings
) -> tuple[GroundFound, list[Finding]]:
    """The road in some scans of a drive, and what looks wrong about it.

    Args:
        scans: (N, 4) each, in the sensor frame.
        said_height: of the sensor above the road, metres.
        settings: of the drive.
    """
    planes = [widest_plane(points, HEIGHTS) for points in scans]
    roads = [plane for plane in planes if plane is not None and _is_road(plane)]
    votes = Counter(_nearest_axis(plane.normal) for plane in roads)
    (up, count), *_ = votes.most_common(1) or [((0.0, 0.0, 1.0), 0)]
    if count <= MAJORITY * len(scans):
        how = f"a flat surface near the sensor in {len(roads)} of {len(scans)} scans only"
        mend = "give whole scans, with the road in them, and look at the picture"
        return GroundFound(np.eye(3), said_height, len(scans) // 2, None), [Finding("no ground found", how, mend)]
    alike = [plane for plane in roads if _nearest_axis(plane.normal) == up]
    height = float(np.median([plane.distance for plane in alike]))
    level = _levels(np.array(up))
    middle = next((k for k, plane in enumerate(planes) if plane is alike[len(alike) // 2]), 0)
    found = GroundFound(level, height, middle, planes[middle])
    if up != (0.0, 0.0, 1.0):
        return found, [_not_up(up, level, height, settings)]
    tilt = _tilt(np.mean([plane.normal for plane in alike], axis=0), settings)
    if tilt is None and abs(height - said_height) > ODD_HEIGHT:
        how = f"the road lies {height:.2f} m below the sensor, which is said to be {said_height:.2f} m above it"
        return found, [Finding("wrong height", how, settings.write(f"sensor: {{height: {height:.2f}}}"))]
    return found, [] if tilt is None else [tilt]


def _is_road(plane: Plane) -> bool:
    within = HEIGHTS[0] <= plane.distance <= HEIGHTS[1]
    return within and plane.share >= LEAST_SHARE and plane.beyond <= MOST_BEYOND * plane.share


def _nearest_axis(normal: FloatArray) -> tuple[float, ...]:
    axis = np.zeros(3)
    k = int(np.argmax(np.abs(normal)))
    axis[k] = np.sign(normal[k])
    return tuple(axis.tolist())


def _levels(up: FloatArray) -> FloatArray:
    """The rotation by right angles that takes `up` to z and turns least else; x stays where it can."""
    able = [turned for turned in SQUARE if turned @ up @ [0, 0, 1] > 0.5]
    return max(able, key=lambda turned: float(np.trace(turned) + 0.1 * turned[0, 0]))


def _not_up(up: tuple[float, ...], level: FloatArray, height: float, settings: Settings) -> Finding:
    k = int(np.argmax(np.abs(up)))
    axis = f"{'-' if up[k] < 0 else ''}{NAMES[k]}"
    mend = settings.write(f"scans: {{{settings.axes('scans', level)}}}")
    if axis == "-z":
        return Finding("scan upside down", f"the road lies {height:.2f} m above the sensor", mend)
    return Finding("wrong axes", f"the road is seen across {axis}, {height:.2f} m from the sensor: z is not up", mend)


def _tilt(normal: FloatArray, settings: Settings) -> Finding | None:
    normal = normal / np.linalg.norm(normal)
    if np.arccos(min(float(normal[2]), 1.0)) < MOST_TILT:
        return None
    roll = float(np.degrees(np.arctan2(normal[1], normal[2])))
    pitch = float(np.degrees(-np.arctan2(normal[0], np.hypot(normal[1], normal[2]))))
    how = f"the road is tilted by {roll:.1f} degrees in roll and {pitch:.1f} in pitch, seen from the sensor"
    return Finding("sensor tilted", how, settings.write(f"sensor: {{angles: [{roll:.1f}, {pitch:.1f}, 0]}}"))
