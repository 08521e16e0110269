"""A recorded drive as it happened: its scans through a stream, as they came or as fast as it goes, and timed."""

import contextlib
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.drives import Drive
from envpred.errors import UserError
from envpred.live.ahead import LiveForecast
from envpred.live.stream import Stream
from envpred.mapping.mapper import Mapped

STAGES = ("ground", "label", "evidence", "velocities", "forecast")
READ, WHOLE = "read", "scan to forecast"


class Step(NamedTuple):
    """What a scan of a replay came to.

    Args:
        frame: its number in the drive.
        points: (N, 3) or more of it that were mapped.
        mapped: what is known after it; None if it was left out.
        forecast: after it, if there is one.
    """

    frame: int
    points: NDArray[np.float32]
    mapped: Mapped | None
    forecast: LiveForecast | None


class Latency:
    """Seconds that each stage of each scan took.

    Attributes:
        stages: seconds by the name of the stage; those of `WHOLE` are of the scans that were followed by a forecast,
            without the time to read them.
        scans: that were replayed.
        forecasts: that came of them.
        dropped: scans that were not looked at, as a newer one was there already.
        slow: scans that took longer than the time to the next.
    """

    def __init__(self) -> None:
        self.stages: dict[str, list[float]] = defaultdict(list)
        self.scans = self.forecasts = self.dropped = self.slow = 0
        self._since = 0.0

    def begin(self) -> None:
        """A stage begins now."""
        self._since = time.perf_counter()

    def end(self, stage: str) -> None:
        """The stage `stage` has ended, and the next one begins."""
        now = time.perf_counter()
        self.stages[stage].append(now - self._since)
        self._since = now

    def rows(self) -> list[tuple[str, ...]]:
        """A table of milliseconds: the stage, median, 95 % and the worst."""
        shown = [name for name in (READ, *STAGES, WHOLE) if self.stages[name]]
        values = {name: 1e3 * np.quantile(self.stages[name], (0.5, 0.95, 1)) for name in shown}
        return [("", "median", "95 %", "worst"), *((n, *(f"{ms:.1f}" for ms in v)) for n, v in values.items())]

    def table(self) -> str:
        """The `rows`, in columns."""
        rows = self.rows()
        width = max(len(row[0]) for row in rows)
        lines = ["  ".join([row[0].ljust(width), *(cell.rjust(7) for cell in row[1:])]).rstrip() for row in rows]
        return "\n".join([f"{lines[0]}  ms", *lines[1:]])


def replay(
    stream: Stream, drive: Drive, latency: Latency, at_rate: bool = False, frames: Sequence[int] | None = None
) -> Iterator[Step]:
    """The scans of `drive` through `stream`, one after the other, while `latency` is measured.

    Args:
        stream: made for the drive.
        drive: that is replayed.
        latency: to add to.
        at_rate: let scans come as they came: who is not ready for one when the next is there, misses it.
        frames: positions in the drive's frames, by default all.

    Raises:
        UserError: if none of the scans can be read; a stream goes on without some of them.
    """
    positions = list(range(len(drive.frames)) if frames is None else frames)
    stream.watch(latency.end)
    start = time.monotonic() - float(drive.times[positions[0]]) if positions else 0.0
    failed = None
    while positions:
        if at_rate:
            positions = _wait(positions, drive, start, latency)
        t = positions.pop(0)
        k = drive.frames[t]
        latency.begin()
        try:
            points = drive.scan(k)
        except UserError as error:
            stream.warn(f"{error}; left out")
            failed = error
            continue
        latency.end(READ)
        before, began = stream.mapped, time.perf_counter()
        forecast = stream.update(points, drive.poses[t], float(drive.times[t]))
        took = time.perf_counter() - began
        latency.scans += 1
        latency.slow += took > drive.period
        if forecast is not None:
            latency.forecasts += 1
            latency.stages[WHOLE].append(took)
        yield Step(k, stream.points, stream.mapped if stream.mapped is not before else None, forecast)
    if failed is not None and not latency.scans:
        raise failed


def warmed(make: Callable[[], Stream], drive: Drive) -> Stream:
    """A stream of `make` after another one has seen a few scans: what is compiled at first use is no latency."""
    first = make()
    first.warn = lambda said: None
    few = range(min(first.forecaster.given + 1, len(drive.frames)))
    with contextlib.suppress(UserError):  # of these; what follows may be read
        deque(replay(first, drive, Latency(), frames=few), maxlen=0)
    return make()


def _wait(positions: list[int], drive: Drive, start: float, latency: Latency) -> list[int]:
    """Wait for the next scan; those that a newer one has overtaken are dropped."""
    now = time.monotonic() - start
    there = [t for t in positions if float(drive.times[t]) <= now]
    if there:
        latency.dropped += len(there) - 1
        return positions[len(there) - 1 :]
    time.sleep(float(drive.times[positions[0]]) - now)
    return positions
