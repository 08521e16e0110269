"""A trained forecaster from its checkpoint alone."""

import inspect
from importlib import import_module
from pathlib import Path

import torch

from envpred.errors import UserError
from envpred.models.checkpoints import read_checkpoint
from envpred.models.forecaster import Forecaster


def load_forecaster(checkpoint: Path | str, device: torch.device | str = "cpu") -> Forecaster:
    """The forecaster that a checkpoint of `envpred fit` holds, ready to forecast.

    Raises:
        UserError: if the file is no checkpoint, or its forecaster's class is not to be found.
    """
    file = Path(checkpoint)
    content = read_checkpoint(file, device)
    class_path = str(content.get("class_path", ""))
    module, _, name = class_path.rpartition(".")
    try:
        kind = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError, TypeError):
        raise UserError(
            f"{file}: holds a forecaster of the class {class_path or 'unknown'}, which Python does not find; install "
            "or import what defines it, or train it again"
        ) from None
    if not (isinstance(kind, type) and issubclass(kind, Forecaster)):
        raise UserError(f"{file}: {class_path} is no forecaster; give a checkpoint that `envpred fit` wrote")
    taken = inspect.signature(kind).parameters
    try:
        forecaster: Forecaster = kind(**{k: v for k, v in content["hyper_parameters"].items() if k in taken})
        forecaster.load_state_dict(content["state_dict"])
    except (RuntimeError, TypeError, ValueError, LookupError, AttributeError):
        raise UserError(f"{file}: its weights are not those of {class_path}; train it again, or give another") from None
    return forecaster.eval().requires_grad_(False).to(device)
