"""The input variants of the paper, as views of what a store holds: adding one is adding a `Variant`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.errors import UserError
from envpred.mapping.dogma import moving_velocity, scaled
from envpred.mapping.evidence import pignistic

Arrays = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Variant:
    """What a forecaster sees of each frame.

    Args:
        name: as --data.variant takes it.
        channels: names of the channels, in order.
        arrays: what the store must hold.
        make_frames: the arrays (T, ...) of a window -> its frames (T, C, H, W).
        vectors: pairs of channels, east and north, that turn with the grid; they lie in [-1, 1].
    """

    name: str
    channels: tuple[str, ...]
    arrays: tuple[str, ...]
    make_frames: Callable[[Arrays], NDArray[np.float32]]
    vectors: tuple[tuple[int, int], ...] = ()

    @property
    def evidential(self) -> bool:
        """Whether the first two channels are masses rather than the first one a probability."""
        return self.channels[:2] == ("occupied", "free")

    @property
    def velocity(self) -> tuple[int, int] | None:
        """The channels of the velocity east and north, if the variant has them."""
        return next((pair for pair in self.vectors if self.channels[pair[0]] == _VELOCITY[0]), None)

    @property
    def empty(self) -> tuple[float, ...]:
        """What the channels of a cell hold of which nothing is known: no mass, or even odds, and no velocity."""
        return (0.0 if self.evidential else 0.5, *[0.0] * (len(self.channels) - 1))

    def probability(self, channels: Tensor) -> Tensor:
        """Probability of occupied (..., H, W), what is judged, of `channels` (..., C, H, W): pignistic for masses."""
        if self.evidential:
            return 0.5 * channels[..., 0, :, :] + 0.5 * (1 - channels[..., 1, :, :])
        return channels[..., 0, :, :]


# Functions with names, so that processes can hand variants to each other.
def _masses(arrays: Arrays) -> NDArray[np.float32]:
    return arrays["evidence"]


def _probability(arrays: Arrays) -> NDArray[np.float32]:
    return pignistic(arrays["evidence"])[:, None]


def _velocity(arrays: Arrays) -> NDArray[np.float32]:
    """Velocities (T, 2, H, W) of the cells that move, one scale for all: 1 is VELOCITY_SCALE m/s."""
    velocity, covariance = (torch.from_numpy(arrays[name]) for name in ("velocity", "velocity_cov"))
    return np.asarray(scaled(moving_velocity(velocity, covariance)).numpy(), np.float32)


def _masses_and_velocity(arrays: Arrays) -> NDArray[np.float32]:
    return np.concatenate([_masses(arrays), _velocity(arrays)], axis=1)


def _probability_and_velocity(arrays: Arrays) -> NDArray[np.float32]:
    return np.concatenate([_probability(arrays), _velocity(arrays)], axis=1)


_DYNAMIC = ("evidence", "velocity", "velocity_cov")
_VELOCITY = ("velocity east", "velocity north")

VARIANTS = {
    variant.name: variant
    for variant in (
        Variant("dst_static", ("occupied", "free"), ("evidence",), _masses),
        Variant("prob_static", ("probability",), ("evidence",), _probability),
        Variant("dst_dogma", ("occupied", "free", *_VELOCITY), _DYNAMIC, _masses_and_velocity, ((2, 3),)),
        Variant("prob_dogma", ("probability", *_VELOCITY), _DYNAMIC, _probability_and_velocity, ((1, 2),)),
    )
}


def variant(name: str) -> Variant:
    """The variant of that name, or the one that a dotted name such as `my_module.MY_VARIANT` leads to.

    Raises:
        UserError: naming those that there are.
    """
    if name in VARIANTS:
        return VARIANTS[name]
    module, _, attribute = name.rpartition(".")
    if module:
        try:
            found = getattr(import_module(module), attribute, None)
        except ImportError as error:
            raise UserError(f"--data.variant {name}: {error}; give a module that Python finds from here") from None
        if isinstance(found, Variant):
            return found
        raise UserError(f"--data.variant {name}: {module} holds no Variant of that name; give one that it holds")
    raise UserError(f"no input variant {name!r}; there are {', '.join(VARIANTS)}, or give module.NAME of your own")
