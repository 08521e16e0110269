"""The input variants of the paper, as views of what a store holds: adding one is adding a `Variant`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
        channels: names of the channels, in order.
        arrays: what the store must hold.
        view: the arrays (T, ...) of a window -> its frames (T, C, H, W).
        velocity: the channels of the velocity east and north, if the variant has them; they lie in [-1, 1].
    """

    channels: tuple[str, ...]
    arrays: tuple[str, ...]
    view: Callable[[Arrays], NDArray[np.float32]]
    velocity: tuple[int, int] | None = None

    @property
    def evidential(self) -> bool:
        """Whether the first two channels are masses rather than the first one a probability."""
        return self.channels[:2] == ("occupied", "free")

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
    "dst_static": Variant(("occupied", "free"), ("evidence",), _masses),
    "prob_static": Variant(("probability",), ("evidence",), _probability),
    "dst_dogma": Variant(("occupied", "free", *_VELOCITY), _DYNAMIC, _masses_and_velocity, (2, 3)),
    "prob_dogma": Variant(("probability", *_VELOCITY), _DYNAMIC, _probability_and_velocity, (1, 2)),
}


def variant(name: str) -> Variant:
    """The variant of that name.

    Raises:
        UserError: naming those that there are.
    """
    if name not in VARIANTS:
        raise UserError(f"no input variant {name!r}; there are {', '.join(VARIANTS)}")
    return VARIANTS[name]
