"""A recording of traffic: streets, and the tracks of everybody on them, read back as smooth motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from envpred.compiled import njit
from envpred.errors import UserError
from envpred.gate import read_arrays
from envpred.gate.stores import recording
from envpred.store.files import replaced

FloatArray = NDArray[np.float64]

KINDS = ("car", "van", "truck", "bicycle", "person")
LANES = ("driving", "parking", "cycleway", "sidewalk", "crossing", "walkingarea", "junction")
RATE = 10.0  # scans a second

_VERSION = 1
_WITHOUT = "give another, or none to use the built-in one"
_UNIT = 0.01  # metres: positions are stored in whole centimetres
_SMOOTH = 3.0  # standard deviation, in scans, that takes the corners out of SUMO's paths
_TOW_STEPS = 5  # steps from scan to scan in which the rear axle is towed
_REAR_AXLE = 0.80  # share of a vehicle's length between its front and its rear axle


@dataclass(frozen=True)
class Track:
    """One road user's front, sampled every `Recording.interval` seconds from sample `start` on."""

    kind: int  # index into KINDS
    length: float
    width: float
    start: int
    heading: float  # at its first sample, radians counter-clockwise from east
    places: FloatArray  # (n, 2) metres


@dataclass(frozen=True)
class Motion:
    """A track at the rate of the scans: positions are of the body's centre on the ground."""

    kind: int
    length: float
    width: float
    first: int  # scan number, counted from the start of the recording
    centre: FloatArray  # (n, 2) metres
    heading: FloatArray  # (n,) radians, without jumps
    speed: FloatArray  # (n,) m/s

    @cached_property
    def rear_axle(self) -> FloatArray:
        """(n, 2) metres; an own vehicle's inertial unit sits above it."""
        back = self.length * (_REAR_AXLE - 0.5)
        return self.centre - back * _direction(self.heading)


@dataclass
class Network:
    """A town's streets and one recording of its traffic."""

    name: str
    lanes: list[tuple[int, float, FloatArray]]  # kind (index into LANES), width, centre line (n, 2)
    junctions: list[FloatArray]  # outlines (n, 2)
    tracks: list[Track] = field(repr=False)

    def longest(self, interval: float) -> int:
        """Scans of the car that is there for the longest time."""
        samples = max((len(t.places) for t in self.tracks if KINDS[t.kind] == "car"), default=1)
        return round((samples - 1) * interval * RATE) + 1


@dataclass
class Recording:
    """Towns with `seconds` of traffic each, a position every `interval` seconds."""

    interval: float
    seconds: float
    networks: list[Network]

    def motions(self, network: int) -> list[Motion]:
        """All tracks of a network as smooth motion, in the order of the recording."""
        return [_motion(t, self.interval) for t in self.networks[network].tracks]

    def save(self, path: Path) -> None:
        """Writes the recording as a compressed npz of a few hundred kilobytes a town."""
        arrays: dict[str, NDArray[np.generic]] = {
            "version": np.array(_VERSION),
            "interval": np.array(self.interval),
            "seconds": np.array(self.seconds),
            "names": np.array([n.name for n in self.networks]),
        }
        for k, network in enumerate(self.networks):
            arrays[f"{k}/lane_kind"] = np.array([lane[0] for lane in network.lanes], np.uint8)
            arrays[f"{k}/lane_width"] = np.array([lane[1] for lane in network.lanes], np.float32)
            arrays |= _pack(f"{k}/lane", [lane[2] for lane in network.lanes])
            arrays |= _pack(f"{k}/junction", network.junctions)
            arrays[f"{k}/track_start"] = np.array([t.start for t in network.tracks], np.int32)
            table = [(t.kind, t.length, t.width, t.heading) for t in network.tracks]
            arrays[f"{k}/track_table"] = np.array(table, np.float32).reshape(-1, 4)
            arrays |= _pack(f"{k}/track", [t.places for t in network.tracks])
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path) as part, part.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: Path) -> "Recording":
        """Reads what `save` wrote; raises UserError for a missing or foreign file."""
        data = read_arrays(path, recording, _WITHOUT)
        if data["version"] != _VERSION:
            raise UserError(f"{path}: a recording of version {data['version']}, this reads {_VERSION}; {_WITHOUT}")
        networks = [_network(path, data, k, str(name)) for k, name in enumerate(data["names"])]
        return cls(float(data["interval"]), float(data["seconds"]), networks)


def _network(path: Path, data: Mapping[str, NDArray[Any]], k: int, name: str) -> Network:
    kinds = max(data[f"{k}/lane_kind"], default=0), max(data[f"{k}/track_table"][:, 0], default=0)
    points = all(data[f"{k}/{w}_count"].sum() == data[f"{k}/{w}_bends"].shape[1] for w in ("lane", "junction", "track"))
    if kinds[0] >= len(LANES) or kinds[1] >= len(KINDS) or not points or min(data[f"{k}/track_count"], default=2) < 2:
        raise UserError(f"{path}: town {k} does not fit together; {_WITHOUT}")
    lanes = list(
        zip(data[f"{k}/lane_kind"].tolist(), data[f"{k}/lane_width"].tolist(), _unpack(data, f"{k}/lane"), strict=True)
    )
    starts, table, places = data[f"{k}/track_start"], data[f"{k}/track_table"], _unpack(data, f"{k}/track")
    tracks = [
        Track(int(row[0]), float(row[1]), float(row[2]), int(start), float(row[3]), line)
        for start, row, line in zip(starts, table, places, strict=True)
    ]
    return Network(name, lanes, _unpack(data, f"{k}/junction"), tracks)


def _pack(name: str, lines: list[FloatArray]) -> dict[str, NDArray[np.generic]]:
    """Lines of points as second differences in centimetres: mostly small numbers, which compress well."""
    first, bends = [], []
    for line in lines:
        whole = np.round(line / _UNIT).astype(np.int32)
        step = np.diff(whole, axis=0, prepend=whole[:1])
        first.append(whole[0])
        bends.append(np.diff(step, axis=0, prepend=step[:1]))
    return {
        f"{name}_count": np.array([len(line) for line in lines], np.int32),
        f"{name}_first": np.array(first, np.int32).reshape(-1, 2),
        f"{name}_bends": np.concatenate(bends or [np.zeros((0, 2))]).T.astype(np.int32),
    }


def _unpack(data: Mapping[str, NDArray[Any]], name: str) -> list[FloatArray]:
    ends = np.cumsum(data[f"{name}_count"])
    parts = np.split(data[f"{name}_bends"].T, ends[:-1]) if len(ends) else []
    return [
        (first + bends.cumsum(axis=0).cumsum(axis=0)) * _UNIT
        for first, bends in zip(data[f"{name}_first"], parts, strict=True)
    ]


def _motion(track: Track, interval: float) -> Motion:
    """A track as motion at 10 Hz: the front follows the smoothed path, the rear axle is towed behind it."""
    n = len(track.places)
    times = np.arange(n) * interval
    fine = np.arange(round(times[-1] * RATE) + 1) / RATE
    front = gaussian_filter1d(CubicSpline(times, track.places)(fine), _SMOOTH, axis=0, mode="nearest")
    drawbar = _REAR_AXLE * track.length
    heading = np.unwrap(_tow(front, drawbar, track.heading))
    centre = front - 0.5 * track.length * _direction(heading)
    speed = np.hypot(*np.gradient(front, 1 / RATE, axis=0).T)
    return Motion(track.kind, track.length, track.width, round(track.start * interval * RATE), centre, heading, speed)


@njit()
def _tow(front, drawbar, heading):  # type: ignore[no-untyped-def]
    """Heading (n,) of a body whose front takes the places `front` (n, 2) and whose rear axle is towed (a tractrix)."""
    headings = np.empty(len(front))
    x, y = front[0, 0] - drawbar * np.cos(heading), front[0, 1] - drawbar * np.sin(heading)
    for k in range(len(front)):
        for part in range(1, _TOW_STEPS + 1):
            ahead = front[max(k - 1, 0)] + part / _TOW_STEPS * (front[k] - front[max(k - 1, 0)])
            heading = np.arctan2(ahead[1] - y, ahead[0] - x)
            x, y = ahead[0] - drawbar * np.cos(heading), ahead[1] - drawbar * np.sin(heading)
        headings[k] = heading
    return headings


def _direction(heading: FloatArray) -> FloatArray:
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)
