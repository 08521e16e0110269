"""FCN as a forecaster: one grid in, one map of probability per horizon out (Itkina et al. 2019, IV-B)."""

import torch
from torch import Tensor

from envpred.datamodules import Forecast, Seen, WindowBatch
from envpred.errors import check_number
from envpred.models.forecaster import Forecaster
from envpred.networks.fcn import FCN8s


class FCNForecaster(Forecaster):
    """FCN-8s with a VGG-16 trunk, which forecasts from the last grid shown alone; l1 loss.

    Args:
        variant: input variant; the paper's is prob_dogma.
        given: frames shown, of which it reads the last.
        horizons: forecasts, the first 0.1 s ahead.
        width: factor on the channels of every layer; 1 is VGG-16's.
        dropout: of the head.
        lr: learning rate of Adam.
        max_epochs: epochs of training.
        init_from: weights that training starts from: name of those that ship, or checkpoint.
    """

    shaping = ("variant", "horizons", "width")

    def __init__(
        self,
        variant: str = "dst_static",
        given: int = 5,
        horizons: int = 15,
        width: float = 1.0,
        dropout: float = 0.5,
        lr: float = 1e-4,
        max_epochs: int = 79,
        init_from: str | None = None,
    ) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        check_number("model.horizons", horizons, 1)
        check_number("model.width", width, above=True)
        check_number("model.dropout", dropout, 0, 1)
        check_number("model.lr", lr)
        check_number("model.max_epochs", max_epochs)
        self.network = FCN8s(len(self.view.channels), horizons, width, dropout)

    @property
    def epochs(self) -> int:
        return int(self.hparams["max_epochs"])

    @property
    def reachable(self) -> int:
        return int(self.hparams["horizons"])

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        maps: Tensor = self.network(seen["frames"][:, -1])
        return Forecast(maps[:, :horizons])

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        assert batch["future"] is not None
        target = batch["future"]["occupancy"]
        loss = (self.forecast(batch["seen"], target.shape[1]).probability - target).abs().mean()
        self.log("train/loss", loss, prog_bar=True, batch_size=len(target))
        return loss

    def configure_optimizers(self) -> torch.optim.Adam:
        return torch.optim.Adam(self.parameters(), lr=self.hparams["lr"])
