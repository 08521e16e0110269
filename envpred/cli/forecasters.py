"""The forecaster that a command line of `envpred fit` and a checkpoint say, without a store of grids."""

from pathlib import Path

from envpred.cli.lightning import EnvpredCLI, lightning
from envpred.errors import UserError
from envpred.gate.weights import found
from envpred.models import Forecaster
from envpred.models.checkpoints import read_checkpoint
from envpred.models.loading import load_forecaster

NEWEST = ("best", "last", "none")  # checkpoints that go by the model


class _Built(EnvpredCLI):
    """The command line of `envpred test`, parsed and built, but not run."""

    def _run_subcommand(self, subcommand: str) -> None:
        pass

    @property
    def checkpoint(self) -> str | None:
        """The checkpoint that weights come from."""
        found: str | None = self._options.get("ckpt_path")
        return found


def chosen_forecaster(fit: list[str], ckpt_path: str | None, weights: str | None = None) -> Forecaster:
    """The forecaster of the options `fit`, with the weights of a checkpoint if one is given; or that of `weights`.

    Raises:
        UserError: if they say none or two, or the checkpoint is not that of the forecaster.
    """
    if weights is not None:
        if fit or ckpt_path is not None:
            given = " and ".join(fit or ["--ckpt_path"])
            raise UserError(f"--weights {weights} says which forecaster: leave {given} out")
        return load_forecaster(found(weights, "--weights"))
    if not fit:
        if ckpt_path is None or ckpt_path in NEWEST:
            raise UserError("say which forecaster: give --config rollout, or another that `envpred configs` lists")
        return load_forecaster(ckpt_path)
    checkpoint = [] if ckpt_path is None else [f"--ckpt_path={ckpt_path}"]
    built = lightning(["test", "--data.store=.", *fit, *checkpoint], _Built)
    forecaster: Forecaster = built.model
    if built.checkpoint is not None:
        content = read_checkpoint(Path(built.checkpoint))
        forecaster.on_load_checkpoint(content)
        forecaster.load_state_dict(content["state_dict"])
    return forecaster.eval().requires_grad_(False)
