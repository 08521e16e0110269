"""Timing things side by side: they take turns, so that a noisy machine meets all of them alike; and peak memory."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path


def medians(
    work: Mapping[str, Callable[[], object]], repeats: int, finish: Callable[[], object] = lambda: None
) -> dict[str, float]:
    """Median seconds of each callable over `repeats` rounds, after one that does not count.

    `finish` is called before the clock is read (torch.cuda.synchronize where the work is not done on return).
    """
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(repeats + 1):
        for name, call in work.items():
            finish()
            start = time.perf_counter()
            call()
            finish()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(taken[1:]) for name, taken in seconds.items()}


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print `rows` under `header`, the first column to the left and the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, ["-" * width for width in widths], *rows):
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


def peak_memory() -> float:
    """Largest resident memory of this process so far, in GiB; getrusage counts that of the one which started it."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) / 2**20
