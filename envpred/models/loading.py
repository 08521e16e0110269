"""A trained forecaster from its checkpoint or from weights that ship, with no code but ours and what the user chose."""

import inspect
import sys
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

import envpred.models
from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError, short
from envpred.gate.arrays import DAMAGED
from envpred.gate.weights import AGAIN, CONFIG, find
from envpred.models.checkpoints import read_checkpoint
from envpred.models.forecaster import Forecaster
from envpred.models.origins import check_origin
from envpred.models.weights import Weights

OURS = "envpred.models"


def load_forecaster(
    checkpoint: Path | str, device: torch.device | str = "cpu", trusted: Collection[str] = ()
) -> Forecaster:
    """The forecaster that a checkpoint of `envpred fit` holds, or weights that ship do, ready to forecast.

    What a checkpoint names is not imported, as to import a module is to run it: a forecaster or an input variant is
    one of ours, of a module that the program has imported itself, or of one that is `trusted`.

    Args:
        checkpoint: file of a run; or the name of weights that ship, or a folder laid out like theirs.
        device: that it forecasts on.
        trusted: names of further modules that may be imported for it.

    Raises:
        UserError: if there are neither, they are damaged, or the forecaster's class is not to be found, or not to be
            trusted.
    """
    file = Path(checkpoint)
    if not file.is_file() and (folder := find(str(checkpoint))) is not None:
        return _ready(of_weights(Weights.read(folder)), device)
    content = read_checkpoint(file, device)
    class_path, parameters = str(content.get("class_path", "")), content.get("hyper_parameters", {})
    kind = _named(class_path, file, trusted)
    if not (isinstance(kind, type) and issubclass(kind, Forecaster)):
        raise UserError(f"{file}: {class_path} is no forecaster; give a checkpoint that `envpred fit` wrote")
    variant = str(parameters.get("variant", ""))
    if variant not in VARIANTS and "." in variant:
        _named(variant, file, trusted)
    taken = inspect.signature(kind).parameters
    try:
        forecaster: Forecaster = kind(**{k: v for k, v in parameters.items() if k in taken})
        forecaster.load_state_dict(content["state_dict"])
        forecaster.trained = content.get("trained")
    except (RuntimeError, TypeError, ValueError, LookupError, AttributeError):
        raise UserError(f"{file}: its weights are not those of {class_path}; train it again, or give another") from None
    return _ready(forecaster, device)


def of_weights(weights: Weights) -> Forecaster:
    """A forecaster with these weights; its class is one of ours, whatever the folder says.

    Raises:
        UserError: if there is none of that name, or the weights are not those of it.
    """
    file, name = weights.folder / CONFIG, str(weights.config["forecaster"])
    kind = getattr(envpred.models, name, None) if name in envpred.models.__all__ else None
    values = weights.checkpoint["hyper_parameters"]
    try:
        with torch.device("meta"):  # no memory, however large the network would be
            check_origin(weights.checkpoint, kind(**values), weights.title)  # type: ignore[misc]
        made: Forecaster = kind(**values)  # type: ignore[misc]
    except DAMAGED:
        raise UserError(f"{file}: {name} is no forecaster of this version, or has other arguments; {AGAIN}") from None
    made.take_weights(weights)
    return made


def _ready(forecaster: Forecaster, device: torch.device | str) -> Forecaster:
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
