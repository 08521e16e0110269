"""What goes wrong with recordings, injected: how each fault is written, what is said of it, and what mends it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from envpred.mapping.geometry import FloatArray
from tests.drives import own

Change = Callable[[own.Recorded], own.Recorded]
TUM = {"format": "tum", "file": "path.txt"}
NED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
CAMERA = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])  # its axes x right, y down, z forward, along the car's
DEGREE = 111_320.0  # metres, of a meridian


class Fault(NamedTuple):
    """How a recording is harmed.

    Args:
        change: of what is recorded.
        said: in its settings, instead of what is true.
        what: is found.
        mends: a pattern of what mends it.
    """

    change: Change
    said: dict[str, Any]
    what: str
    mends: str


def scans(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Other points."""
    return lambda r: r._replace(scans=[change(points).astype(np.float32) for points in r.scans])


def turned(rotation: Any) -> Change:
    """Scans in other axes."""
    matrix = np.array(rotation, np.float64)
    return scans(lambda points: np.column_stack([points[:, :3] @ matrix.T, points[:, 3]]))


def _with_sensor(r: own.Recorded, sensor: FloatArray) -> own.Recorded:
    """Other poses of the sensor."""
    return r._replace(body=sensor @ np.linalg.inv(own.offset(r.place)))


def poses(axes: FloatArray, world: FloatArray) -> Change:
    """Poses of a frame whose axes are the columns of `axes`, in a world whose axes are the columns of `world`."""

    def change(r: own.Recorded) -> own.Recorded:
        left, right = np.eye(4), np.eye(4)
        left[:3, :3], right[:3, :3] = world.T, axes
        return _with_sensor(r, left @ r.sensor @ right)

    return change


def units(*number: float) -> Change:
    """Poses of so many units a metre, along x, y and z where they differ."""

    def change(r: own.Recorded) -> own.Recorded:
        sensor = r.sensor
        sensor[:, :3, 3] *= number
        return _with_sensor(r, sensor)

    return change


def inverted(r: own.Recorded) -> own.Recorded:
    """Poses that lead from the world to the car."""
    return _with_sensor(r, np.asarray(np.linalg.inv(r.sensor), np.float64))


def same(r: own.Recorded) -> own.Recorded:
    """As it was; the settings lie."""
    return r


def without(r: own.Recorded) -> own.Recorded:
    """Four frames are missing."""
    kept = [k for k in range(len(r.scans)) if not 20 <= k < 24]
    return r._replace(
        scans=[r.scans[k] for k in kept], since=[r.since[k] for k in kept], body=r.body[kept], times=r.times[kept]
    )


def lower(height: float) -> dict[str, Any]:
    """Settings of a sensor that is said to be at another height."""
    return {"sensor": {"height": height, "place": own.PLACE.tolist()}}


CAR_POSES = {"poses": {**TUM, "axes": ["forward", "left", "up"]}}
PITCHED = [[0.9848, 0, 0.1736], [0, 1, 0], [-0.1736, 0, 0.9848]]
FAULTS: dict[str, Fault] = {
    "upside down": Fault(
        *(turned(np.diag([1, -1, -1])), CAR_POSES, "scan upside down"),
        r"scans: \{axes: \[forward, right, down\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "on its side": Fault(
        *(turned([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), CAR_POSES, "wrong axes"),
        r"scans: \{axes: \[forward, down, left\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "x right, y forward": Fault(
        *(turned([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), {}, "wrong axes"),
        r"scans: \{axes: \[right, forward, up\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "no ground": Fault(scans(lambda p: p[p[:, 2] > -1.5]), {}, "no ground found", "give whole scans"),
    "another height": Fault(same, lower(1.2), "wrong height", r"sensor: \{height: 2\.0[789]\}"),
    "tilted": Fault(turned(PITCHED), CAR_POSES, "sensor tilted", r"sensor: \{angles: \[-?0\.\d, -(9|10)\.\d, 0\]\}"),
    "millimetres": Fault(units(1000), {}, "poses in other units", r"poses: \{scale: 0\.001\}"),
    "kilometres": Fault(units(0.001), {}, "poses in other units", r"poses: \{scale: 1000\}"),
    "feet": Fault(units(1 / 0.3048), {}, "poses in other units", r"poses: \{scale: 0\.3048\}"),
    "north, east, down": Fault(
        *(poses(np.diag([1.0, -1, -1]), NED), {}, "poses in another frame"),
        r"poses: \{axes: \[forward, right, down\], world: \[north, east, down\]\}",
    ),
    "camera": Fault(
        *(poses(CAMERA, CAMERA), {}, "poses in another frame"),
        r"poses: \{axes: \[right, down, forward\], world: \[south, down, east\]\}",
    ),
    "world to car": Fault(inverted, {}, "poses in another frame", r"poses: \{inverse: true\}"),
    "clock ahead": Fault(same, {"poses": {**TUM, "clock": 0.2}}, "clock offset", r"poses: \{clock: -?0\.0[0-2]\}"),
    "clock behind": Fault(same, {"poses": {**TUM, "clock": -0.3}}, "clock offset", r"poses: \{clock: -?0\.0[0-2]\}"),
    "gap": Fault(without, {}, "gaps", "1 in 56 frames, the longest 0.5 s after frame 19, .*copy the scans"),
}
