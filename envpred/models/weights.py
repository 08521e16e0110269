"""Weights in the layout of `envpred.gate.weights`: written in half precision, read and compared with what they name."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from envpred.errors import UserError
from envpred.gate.weights import AGAIN, CONFIG, TENSORS, read_config


@dataclass(frozen=True)
class Weights:
    """Weights and what is to be known of them.

    Args:
        folder: where they lie.
        config: what `config.json` says.
        state: single precision, by name.
    """

    folder: Path
    config: dict[str, Any]
    state: dict[str, Tensor]

    @classmethod
    def read(cls, folder: Path) -> "Weights":
        """The weights in a folder.

        Raises:
            UserError: if a file is missing, damaged, of another format, or not what `config.json` says.
        """
        config, file = read_config(folder), folder / TENSORS
        try:
            content = file.read_bytes()
        except OSError as error:
            raise UserError(f"{file}: cannot be read ({error.strerror}); {AGAIN}") from None
        if hashlib.sha256(content).hexdigest() != config["sha256"]:
            raise UserError(f"{file}: damaged, or not what {CONFIG} beside it tells of; {AGAIN}")
        try:
            state = {name: single(tensor) for name, tensor in load(content).items()}
        except SafetensorError as error:
            raise UserError(f"{file}: holds no weights ({error}); {AGAIN}") from None
        return cls(folder, config, state)

    @property
    def title(self) -> str:
        """How messages call what they are of."""
        return f"the network of {self.folder.name}"

    @property
    def checkpoint(self) -> dict[str, Any]:
        """What a checkpoint of the same training would say of itself."""
        config = self.config
        weights = {"name": config["name"], "sha256": config["sha256"]}
        return {
            "forecaster": config["forecaster"],
            "hyper_parameters": {**config["init_args"], "variant": config["variant"], "given": config["given"]},
            "state_dict": self.state,
            "trained": {**config["training"], "weights": weights},
        }


def halved(state: Mapping[str, Tensor]) -> bytes:
    """Weights as a file of safetensors, floating ones in half precision; same weights, same bytes."""
    return save({name: (t.half() if t.is_floating_point() else t).contiguous().cpu() for name, t in state.items()})


def single(tensor: Tensor) -> Tensor:
    """A tensor of a file, floating ones in single precision."""
    return tensor.to(torch.float32) if tensor.is_floating_point() else tensor
