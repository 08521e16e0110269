"""Drives of our own with known truth: SUMO's traffic, towns drawn from a seed, an HDL-64E, KITTI raw's layout."""

from pathlib import Path


def simulate(
    out: Path,
    drives: int = 10,
    frames: int = 150,
    seed: int = 0,
    processes: int | None = None,
    recording: Path | None = None,
) -> None:
    """See `run.simulate`; the ray caster is imported only when it is used."""
    from envpred.drives.simulate.run import simulate

    simulate(out, drives, frames, seed, processes, recording)
