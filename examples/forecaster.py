"""A forecaster of your own is one file: what it needs, what it sees, what it says, how it trains.

envpred fit --model.class_path forecaster.ContextForecaster --data.store grids/   # in this file's folder
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from envpred.datamodules import Forecast, Needs, Seen, WindowBatch
from envpred.models import Forecaster


class ContextForecaster(Forecaster):
    """Two convolutions over the wide grid, the velocities of the particle filter and the ego's speed.

    Args:
        variant: input variant.
        given: frames shown.
        width: channels of the hidden layer.
        lr: learning rate of Adam.
    """

    needs = Needs(arrays=("velocity",), context=True)
    shaping = ("variant", "width")

    def __init__(self, variant: str = "dst_static", given: int = 5, width: int = 8, lr: float = 1e-2) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        inputs = len(self.view.channels) + 2 + 1 + 1  # context, velocity, speed, horizon
        self.layers = nn.Sequential(
            nn.Conv2d(inputs, width, 5, padding=2), nn.ReLU(), nn.Conv2d(width, 1, 5, padding=2), nn.Sigmoid()
        )

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        context, velocity = seen["context"][:, -1], seen["arrays"]["velocity"][:, -1].float()
        margin = (context.shape[-1] - velocity.shape[-1]) // 2
        moved = (seen["pose"][:, -1, :2] - seen["pose"][:, 0, :2]).norm(dim=-1)  # cells over the frames shown
        speed = moved[:, None, None, None].expand_as(context[:, :1])
        now = torch.cat([context, pad(velocity / 20, (margin,) * 4), speed / 10], dim=1)
        maps = [self.layers(torch.cat([now, torch.full_like(speed, h / 10)], dim=1)) for h in range(horizons)]
        inside = slice(margin, context.shape[-1] - margin)
        return Forecast(torch.cat(maps, dim=1)[..., inside, inside])

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        assert batch["future"] is not None
        target = batch["future"]["occupancy"]
        return (self.forecast(batch["seen"], target.shape[1]).probability - target).square().mean()

    def configure_optimizers(self) -> torch.optim.Adam:
        return torch.optim.Adam(self.parameters(), lr=self.hparams["lr"])
