"""The checkpoint that `best` or `last` stands for: that of the training which wrote one last."""

from pathlib import Path

from envpred.errors import UserError
from envpred.results.validations import read_validations


def newest_checkpoint(place: Path, which: str) -> Path:
    """The `best` or `last` checkpoint of that run in the folder `place` which wrote one last.

    Raises:
        UserError: if there is none.
    """
    wanted = ("best.ckpt", "best_t1.ckpt") if which == "best" else ("last.ckpt",)
    for run in sorted(place.glob("*/checkpoints"), key=_written, reverse=True):
        for name in wanted:
            if (run / name).is_file():
                return run / name
    raise UserError(f"{place}: no run with a checkpoint {wanted[0]}; run `envpred fit` first, or give its path")


def about_checkpoint(file: Path) -> str:
    """What else is to be known of a checkpoint that was found: how far its run came, and newer runs without any."""
    run, when = file.parents[1], _written(file.parent)
    state = f"its run has {'not ' if read_validations(run).ended is None else ''}reached its end"
    others = [other for other in run.parent.iterdir() if other.is_dir() and not _written(other / "checkpoints")]
    newer = sorted(other.name for other in others if any(f.stat().st_mtime_ns > when for f in other.iterdir()))
    if not newer:
        return state
    without = f"newer, but ended before their first checkpoint: {', '.join(newer)}"
    return f"{state}; {without}; to begin again leave --ckpt_path out"


def _written(folder: Path) -> int:
    """When a checkpoint was last written into a folder."""
    return max((file.stat().st_mtime_ns for file in folder.glob("*.ckpt")), default=0)
