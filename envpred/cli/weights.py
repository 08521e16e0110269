"""`--weights NAME` of validate, test and predict: the configuration that weights say of themselves, and the weights."""

from typing import Any

import yaml

from envpred.cli.registry import LIGHTNING
from envpred.errors import UserError
from envpred.gate.weights import found, read_config
from envpred.models import Forecaster
from envpred.models.weights import Weights

_OPTION = "--weights="


def with_configuration(args: list[str]) -> list[str]:
    """A command line of Lightning's with the model's configuration of its --weights in front of these.

    Raises:
        UserError: if there are no such weights, or training is asked for.
    """
    if not args or args[0] not in LIGHTNING:
        return args
    return [args[0], *(part for token in args[1:] for part in _with_configuration(token, args[0]))]


def _with_configuration(token: str, command: str) -> list[str]:
    name = token.removeprefix(_OPTION)
    if name == token or name in ("null", "None"):
        return [token]
    folder = found(name, "--weights")
    config = read_config(folder)
    if command == "fit":
        raise UserError(
            f"--weights {name}: is for validate, test and predict; to train further, name the model's --config and "
            f"give --model.init_from {name}"
        )
    model = {"class_path": config["forecaster"], "init_args": config["init_args"]}
    told = {"model": model, "data": {"variant": config["variant"], "given": config["given"]}}
    return [f"--config={yaml.safe_dump(told, default_flow_style=True, width=10**6).strip()}", token]


def check_alone(options: Any) -> None:
    """Refuse weights together with a checkpoint.

    Raises:
        UserError: if both are given.
    """
    if options.get("weights") is not None and options.get("ckpt_path") is not None:
        raise UserError(f"--weights {options.weights} and --ckpt_path {options.ckpt_path}: give one of the two")


def take(forecaster: Forecaster, options: Any) -> None:
    """Let a forecaster take the weights that are asked for, if any.

    Raises:
        UserError: if they are missing, damaged, or those of another forecaster or variant.
    """
    if options.get("weights") is not None:
        forecaster.take_weights(Weights.read(found(options.weights, "--weights")))
