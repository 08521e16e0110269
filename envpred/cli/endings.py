"""What fit, validate and test say at their end: where a run lies, what was measured, and what to type next."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lightning.pytorch import Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from numpy.typing import NDArray
from torch import Tensor

from envpred.callbacks.baselines import MOVED, moved_last_frame
from envpred.callbacks.validations import best_validation, history
from envpred.gate.runs import Validation
from envpred.horizons import in_seconds, shown_steps
from envpred.metrics.about import About
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.skill import skill_against
from envpred.metrics.windows import PerHorizon
from envpred.models import Forecaster
from envpred.results.result import short_name

CONFIG = "config.yaml"  # what Lightning's command line writes into a run's folder
STATIC_BASELINE, MOVED_LAST_FRAME = "static baseline", "moved last frame"
UNIT = f"MSE {HorizonMSE.unit}"


def end_of_fit(trainer: Trainer) -> list[str]:
    """Lines that say where the run lies, how good its best checkpoint is, and the command that tests that.

    Nothing of a trial run (`fast_dev_run`), which leaves none of this; and no command without a best checkpoint.
    """
    folder = Path(trainer.log_dir or trainer.default_root_dir)  # all processes agree on it together
    best = best_validation(trainer)
    if trainer.fast_dev_run:  # type: ignore[attr-defined]
        return []
    lines = [f"run: {folder}"]
    if best is None:
        return lines
    validation = best.validation
    errors = {best.checkpoint: validation["val_mse"], STATIC_BASELINE: validation["static_mse"]}
    if f"{MOVED}/mse" in trainer.callback_metrics:
        errors[MOVED_LAST_FRAME] = float(trainer.callback_metrics[f"{MOVED}/mse"])
    told = ", ".join(f"{name} {HorizonMSE.factor * error:.{HorizonMSE.digits}f}" for name, error in errors.items())
    lines.append(f"validation {UNIT}, mean of all horizons: {told} (epoch {validation['epoch']})")
    initial = history(trainer).initial
    if initial is not None:
        lines.append(_gain(str(trainer.lightning_module.hparams["init_from"]), initial, validation))
    found = next((c.dirpath for c in trainer.checkpoint_callbacks if isinstance(c, ModelCheckpoint) and c.dirpath), "")
    checkpoint, config = Path(found) / best.checkpoint, folder / CONFIG
    if folder.resolve() in checkpoint.resolve().parents:
        checkpoint = folder / checkpoint.resolve().relative_to(folder.resolve())  # as short as the folder is told
    if checkpoint.is_file() and config.is_file():
        lines.append(
            f"next: {shlex.join(['envpred', 'test', '--config', str(config), '--ckpt_path', str(checkpoint)])}"
        )
    return lines


def _gain(source: str, before: Validation, after: Validation) -> str:
    """Whether training has made the weights that it started from better, on the validation windows."""
    was, now = (HorizonMSE.factor * found["val_mse"] for found in (before, after))
    told = f"before training, {source}: {was:.{HorizonMSE.digits}f}"
    return f"{told}; {1 - now / was:.1%} less now" if now < was else f"{told}; training did not help, so keep {source}"


def end_of_validation(trainer: Trainer, forecaster: Forecaster) -> list[str]:
    """A table of what was validated, beside both baselines."""
    moved = moved_last_frame(trainer)
    return _table(forecaster, "val", forecaster.validated, {} if moved is None else {MOVED_LAST_FRAME: moved})


def end_of_test(trainer: Trainer, forecaster: Forecaster) -> list[str]:
    """A table of what was tested, beside the static baseline."""
    return _table(forecaster, "test", forecaster.tested, {})


def _table(forecaster: Forecaster, part: str, found: Mapping[str, Any], beside: Mapping[str, PerHorizon]) -> list[str]:
    """Squared error at the shown horizons, and the skill against the static baseline.

    Args:
        forecaster: whose errors they are.
        part: of the drives that was judged.
        found: its `mse` and the static baseline's `static_mse`.
        beside: errors of other methods on the same windows.
    """
    # The report brings along more than a run needs.
    from envpred.report.statistics import drive_errors, ratio_drive_errors
    from envpred.report.table import Cell

    mse, static, data = found["mse"], found["static_mse"], forecaster.dataset
    steps = shown_steps(data.horizons, data.period)
    places = data.datasets[part].places
    drives = [places[n].drive.name for n in mse.index.tolist()]

    def row(name: str, values: Tensor, errors: Tensor, by_drive: NDArray[np.float64], about: About) -> list[str]:
        told = [[about.factor * float(numbers[n - 1]) for numbers in (values, errors, by_drive)] for n in steps]
        return [name, *(Cell(value=v, error=e, drive_error=d, digits=about.digits).plain() for v, e, d in told)]

    name = short_name(type(forecaster).__name__)
    methods = {name: mse}
    if forecaster.role != "static":
        methods |= {STATIC_BASELINE: static, **beside}
    rows = [["", *(in_seconds(n * data.period) for n in steps)]]
    for method, error in methods.items():
        by_drive = drive_errors(error.per_window.numpy(), drives)
        rows.append(row(method, error.mean, error.standard_error, by_drive, error.about))
    if forecaster.role != "static":
        skill = skill_against(mse, static)
        by_drive = ratio_drive_errors(mse.per_window.numpy(), static.per_window.numpy(), drives)
        rows.append(row("skill", skill.value, skill.standard_error, by_drive, skill.about))
    errors = f"± standard error over {len(set(drives))} drives (over {len(drives)} windows, as if independent)"
    return [f"{UNIT} {errors}; skill against the static baseline", *_aligned(rows)]


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows with the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(f"{text:{'<' if k == 0 else '>'}{widths[k]}}" for k, text in enumerate(row)).rstrip() for row in rows
    ]
