"""Forecasters without parameters, for comparison; they run through the same `validate` and `test`."""

from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.models.forecaster import Forecaster


class LastFrame(Forecaster):
    """The static baseline: the last frame shown stands for every horizon."""

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()

    def forecast(self, batch: WindowBatch, given: int = 5) -> Tensor:
        occupancy = batch["occupancy"]
        return occupancy[:, given - 1 : given].expand_as(occupancy[:, given:])

    def configure_optimizers(self) -> None:
        """Nothing is trained."""
