"""The result of a test run: the one place where `result.json` is written."""

from collections.abc import Callable, Mapping
from pathlib import Path

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info

from envpred.callbacks.provenance import provenance
from envpred.metrics.windows import WindowMetric
from envpred.models import Forecaster
from envpred.results.result import RESULT, name_pictures, write_result


class ResultWriter(Callback):
    """Writes what a test run measured into its folder, with all that a report and paired statistics need.

    Args:
        metrics: classes of metrics of your own that are measured beside the standard ones.
    """

    def __init__(self, metrics: list[Callable[[int], WindowMetric]] | None = None) -> None:
        self.metrics = metrics or []
        self.folder = Path()
        self.file: Path | None = None

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Let the forecaster measure our metrics too."""
        if stage == "test" and isinstance(pl_module, Forecaster):
            pl_module.extra_metrics = self.metrics

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.folder = Path(trainer.log_dir or trainer.default_root_dir)  # all processes agree on it together
        self.file = None

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the result, unless that is done."""
        if trainer.is_global_zero and not trainer.fast_dev_run and isinstance(pl_module, Forecaster):  # type: ignore[attr-defined]
            self.write(trainer, pl_module)

    def write(self, trainer: Trainer, forecaster: Forecaster) -> Path:
        """Write the result of the test that has just ended, once; returns its file."""
        if self.file is None:
            result = {
                **provenance(forecaster, "test"),
                "metrics": {name: value.as_json() for name, value in forecaster.tested.items()},
                "forecast_seconds_per_window": forecaster.forecast_seconds / max(forecaster.forecast_windows, 1),
            }
            self.file = write_result(self.folder / RESULT, result)
            rank_zero_info(f"result: {self.file}")
        return self.file

    def add_pictures(
        self, trainer: Trainer, forecaster: Forecaster, pictures: Mapping[str, str], drawn: str | None
    ) -> None:
        """Name pictures, and the file of the forecasts that are `drawn`, in the result, by paths from its folder."""
        name_pictures(self.write(trainer, forecaster), pictures, drawn)


def result_writer(trainer: Trainer) -> ResultWriter | None:
    """The trainer's writer of results, if it has one."""
    return next((c for c in trainer.callbacks if isinstance(c, ResultWriter)), None)  # type: ignore[attr-defined]
