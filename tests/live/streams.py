"""Streams of a small drive, and what else their tests share."""

from typing import Any

from envpred.drives import Drive
from envpred.live.stream import Stream
from envpred.mapping.geometry import GridSpec
from envpred.models import LastFrame

GRID = GridSpec(32)


def ready(drive: Drive, **options: Any) -> tuple[Stream, list[str]]:
    """A stream that has seen the first ten frames, and what it will say."""
    said: list[str] = []
    stream = Stream.of(LastFrame(), drive, grid=GRID, warn=said.append, **options)
    for k in drive.frames[:10]:
        stream.update(drive.scan(k), drive.pose(k), drive.time(k))
    assert not said
    return stream, said


def feed(stream: Stream, drive: Drive, frames: range, **changes: Any) -> list[bool]:
    """Whether each of these frames was followed by a forecast; `changes` are added to times or poses."""
    found = []
    for k in frames:
        pose = drive.pose(k).copy()
        pose[:2, 3] += changes.get("moved", 0.0)
        points = changes.get("points", lambda points: points)(drive.scan(k))
        found.append(stream.update(points, pose, drive.time(k) + changes.get("later", 0.0)) is not None)
    return found
