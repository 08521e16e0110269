"""`envpred live`: a recorded drive as it happens, forecast scan by scan; how long that takes, and how it looks."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tqdm import tqdm

from envpred.build.every import thinned
from envpred.build.jobs import say
from envpred.drives import Drive, one_drive
from envpred.errors import UserError, check_number
from envpred.interrupts import ends_at_once
from envpred.mapping.geometry import GridSpec

if TYPE_CHECKING:  # it brings torch along
    from envpred.live.replay import Step
    from envpred.live.stream import Stream
    from envpred.mapping.dogma import DogmaParameters

Viewer = Callable[["Step"], object]


def live(
    source: Path,
    fit: list[str],
    drive: str | None = None,
    weights: str | None = None,
    ckpt_path: str | None = None,
    out: list[Path] | None = None,
    pace: Literal["fast", "sensor"] = "fast",
    delay: float = 0.0,
    frames: int = 50,
    every: int = 1,
    grid: GridSpec | None = None,
    context: int | None = None,
    particles: "DogmaParameters | None" = None,
) -> None:
    """Replay a drive scan by scan, forecast after each, and tell how long every stage takes.

    Args:
        source: folder of a drive, or with drives.
        fit: options of `envpred fit` that say which forecaster (--config rollout, --model.*).
        drive: name of the drive; by default the first.
        weights: which forecaster, trained: one that ships, by name (`envpred configs`), or a folder of your own.
        ckpt_path: checkpoint to take weights from; best or last, those of the newest fit of this model and variant;
            alone, it says which forecaster.
        out: what to write, by the ending: a page that plays the replay (.html), a recording for Rerun (.rrd, extra
            viewer), or both between commas.
        pace: fast, one scan after the other; or sensor, as they came, dropping those that a newer one has overtaken.
        delay: seconds between a scan and the moment that its forecast is used: forecasts count from there.
        frames: with forecasts in the page at most, spread evenly; each takes about 90 kB.
        every: take every so many scans alone: 2 makes 10 Hz of a drive of 20 Hz.
        grid: cells and resolution; by default those that the weights were trained on, else the paper's.
        context: cells of the wide grid, where the forecaster needs one.
        particles: numbers of the particle filter, where the forecaster needs velocities; by default those relative to
            the ground.
    """
    check_number("frames", frames, 1)
    check_number("every", every, 1)
    files = [_known(file) for file in out or []]
    chosen = thinned(one_drive(source, drive), every)
    if not chosen.frames:
        raise UserError(f"{chosen.name}: no frame has both a scan and a pose; check that both are unpacked")
    with ends_at_once():
        from envpred.cli.forecasters import chosen_forecaster
        from envpred.live.replay import Latency, replay, warmed
        from envpred.live.stream import Stream

    forecaster = chosen_forecaster(fit, ckpt_path, weights)

    def make() -> Stream:
        options = {"grid": grid, "context": context, "velocities": particles, "delay": delay}
        return Stream.of(forecaster, chosen, warn=lambda said: say(f"warning: {said}"), **options)

    with ends_at_once():  # the compiler has C callbacks, in which the exception of a Ctrl-C would be lost
        stream, latency = warmed(make, chosen), Latency()
    with contextlib.ExitStack() as stack:
        viewers = [stack.enter_context(_viewer(file, stream, chosen, frames)) for file in files]
        steps = replay(stream, chosen, latency, at_rate=pace == "sensor")
        for step in tqdm(steps, "replaying", len(chosen.frames), unit="scan", disable=None, file=sys.stderr):
            for show in viewers:
                show(step)
    counted = f"{latency.scans} scans, {latency.forecasts} forecasts, {latency.dropped} scans dropped"
    print(f"{chosen.name}: {counted}, {latency.slow} took longer than the {chosen.period:.3g} s to the next")
    print(latency.table())
    for file in files:
        print(file)


def _known(file: Path) -> Path:
    """A file whose ending says what is to be written.

    Raises:
        UserError: if it does not, or a library is missing.
    """
    if file.suffix == ".rrd":
        from envpred.live.recording import check_installed

        check_installed()
    elif file.suffix != ".html":
        raise UserError(f"--out {file}: end its name on .html for a page, or on .rrd for a recording")
    return file


def _viewer(file: Path, stream: "Stream", drive: Drive, frames: int) -> AbstractContextManager[Viewer]:
    """What shows a replay in `file`, whole or not at all."""
    if file.suffix == ".rrd":
        from envpred.live.recording import recording

        return recording(file, stream, drive)
    return _page(file, stream, drive, frames)


@contextmanager
def _page(file: Path, stream: "Stream", drive: Drive, frames: int) -> Iterator[Viewer]:
    from envpred.live.player import Player
    from envpred.results.result import short_name

    player = Player(stream, drive.name, short_name(type(stream.forecaster).__name__), len(drive.frames), frames)
    yield player.add
    player.write(file)
