"""A trained forecaster from its checkpoint alone, with no code but ours and what the user has chosen."""

import inspect
import sys
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError, short
from envpred.models.checkpoints import read_checkpoint
from envpred.models.forecaster import Forecaster

OURS = "envpred.models"


def load_forecaster(
    checkpoint: Path | str, device: torch.device | str = "cpu", trusted: Collection[str] = ()
) -> Forecaster:
    """The forecaster that a checkpoint of `envpred fit` holds, ready to forecast.

    What a checkpoint names is not imported, as to import a module is to run it: a forecaster or an input variant is
    one of ours, of a module that the program has imported itself, or of one that is `trusted`.

    Args:
        checkpoint: file of a run.
        device: that it forecasts on.
        trusted: names of further modules that may be imported for it.

    Raises:
        UserError: if the file is no checkpoint, or its forecaster's class is not to be found, or not to be trusted.
    """
    file = Path(checkpoint)
    content = read_checkpoint(file, device)
    class_path, parameters = str(content.get("class_path", "")), content["hyper_parameters"]
    kind = _named(class_path, file, trusted)
    if not (isinstance(kind, type) and issubclass(kind, Forecaster)):
        raise UserError(f"{file}: {class_path} is no forecaster; give a checkpoint that `envpred fit` wrote")
    variant = parameters.get("variant", "")
    if variant not in VARIANTS and "." in str(variant):
        _named(str(variant), file, trusted)
    taken = inspect.signature(kind).parameters
    try:
        forecaster: Forecaster = kind(**{k: v for k, v in parameters.items() if k in taken})
        forecaster.load_state_dict(content["state_dict"])
        forecaster.trained = content.get("trained")
    except (RuntimeError, TypeError, ValueError, LookupError, AttributeError):
        raise UserError(f"{file}: its weights are not those of {class_path}; train it again, or give another") from None
    return forecaster.eval().requires_grad_(False).to(device)


def _named(path: str, file: Path, trusted: Collection[str]) -> Any:
    """What a dotted name in a checkpoint leads to."""
    module, _, name = path.rpartition(".")
    if module and not (module in sys.modules or module in trusted or f"{module}.".startswith(f"{OURS}.")):
        raise UserError(
            f"{file}: names {short(path)}, and its code would run; if you trust {short(module)}, import it before, or "
            "give it as trusted=[...]"
        )
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError, TypeError):
        raise UserError(
            f"{file}: names {short(path)}, which Python does not find; install what defines it, or train it again"
        ) from None
