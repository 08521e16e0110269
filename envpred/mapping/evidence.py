"""Evidential occupancy grids: Dempster-Shafer masses of occupied and free, accumulated over a drive (Nuss et al. 2015).

A cell carries m(O) and m(F); what is left, 1 - m(O) - m(F), is ignorance.  Channel order: (occupied, free).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.errors import check_number
from envpred.mapping.geometry import EGO, FREE, OCCUPIED
from envpred.mapping.period import PERIOD

Mass = NDArray[np.float32]


@dataclass(frozen=True)
class EvidenceParameters:
    """Masses that a label stands for, and how fast old evidence fades (values of Itkina et al. 2019).

    Args:
        occupied: m(O) of a cell measured as occupied.
        free: m(F) of a cell measured as free.
        ego: m(O) of a cell under the ego.
        discount: factor alpha on the masses of the past, per frame of 0.1 s.
    """

    occupied: float = 0.95
    free: float = 0.95
    ego: float = 1.0
    discount: float = 0.9

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(f"evidence.{name}", value, 0, 1)

    def at(self, period: float) -> "EvidenceParameters":
        """These parameters for frames that lie `period` seconds apart: masses fade as fast in time as at 0.1 s."""
        return replace(self, discount=self.discount ** (period / PERIOD))

    def table(self) -> Mass:
        """Measured masses (4, 2) of the label codes."""
        masses = np.zeros((4, 2), np.float32)
        masses[OCCUPIED, 0], masses[FREE, 1], masses[EGO, 0] = self.occupied, self.free, self.ego
        return masses


PAPER = EvidenceParameters()


def measured(labels: NDArray[np.uint8], parameters: EvidenceParameters = PAPER) -> Mass:
    """Measurement masses (..., 2, H, W) of `labels` (..., H, W)."""
    return np.moveaxis(parameters.table()[labels], -1, -3)


def accumulate(
    labels: NDArray[np.uint8], centre_cell: NDArray[np.integer], parameters: EvidenceParameters = PAPER
) -> Mass:
    """Posterior masses (T, 2, H, W) of a whole drive.

    Args:
        labels: (T, H, W) label codes.
        centre_cell: (T, 2) lattice cell at each grid's centre; only differences matter.
        parameters: masses and discount.

    Raises:
        ValueError: if the shapes do not belong together.
    """
    if labels.ndim != 3 or centre_cell.shape != (len(labels), 2):
        raise ValueError(f"labels (T,H,W) and centre_cell (T,2) expected, not {labels.shape} and {centre_cell.shape}")
    mass = np.empty((len(labels), 2, *labels.shape[1:]), np.float32)
    prior = np.zeros((2, *labels.shape[1:]), np.float32)
    for t in range(len(labels)):
        prior = mass[t] = step(prior, labels[t], centre_cell[t] - centre_cell[max(t - 1, 0)], parameters)
    return mass


def step(
    prior: Mass, label: NDArray[np.uint8], shift: NDArray[np.integer], parameters: EvidenceParameters = PAPER
) -> Mass:
    """Posterior masses (2, H, W) after one more label grid.

    Args:
        prior: (2, H, W) posterior masses of the frame before, zeros at the start.
        label: (H, W) label codes of this frame.
        shift: (2,) how far the grid has moved since, in cells; cells that enter carry no mass.
        parameters: masses and discount.

    Raises:
        ValueError: if the shapes do not belong together.
    """
    if label.ndim != 2 or prior.shape != (2, *label.shape) or len(shift) != 2:
        raise ValueError(f"prior (2,H,W), label (H,W), shift (2,) expected: {prior.shape}, {label.shape}, {len(shift)}")
    posterior = np.empty_like(prior)
    _fuse(posterior, prior, label, int(shift[0]), int(shift[1]), parameters.table(), np.float32(parameters.discount))
    return posterior


def pignistic(mass: NDArray[np.floating]) -> NDArray[np.float32]:
    """Pignistic probability of occupied (..., H, W) of `mass` (..., 2, H, W): half of the ignorance counts."""
    mass = mass.astype(np.float32, copy=False)
    return np.asarray(0.5 * mass[..., 0, :, :] + 0.5 * (1 - mass[..., 1, :, :]), np.float32)


@njit(nogil=True, error_model="numpy", inline="always")
def aged(occupied, free, alpha):  # type: ignore[no-untyped-def]
    """Masses of one cell a frame later: both caps take the masses before aging, so that m(O) + m(F) <= 1 stays true."""
    one = np.float32(1)
    return min(alpha * occupied, one - free), min(alpha * free, one - occupied)


@njit(nogil=True, error_model="numpy", inline="always")
def combined(occupied, free, seen_occupied, seen_free):  # type: ignore[no-untyped-def]
    """Dempster's rule of combination for one cell: masses of the past and those just measured.

    What agrees adds up to 1 - K, with K the mass in conflict; summed like this, and not from K, no mass leaves [0, 1]
    by rounding.
    """
    one, zero = np.float32(1), np.float32(0)
    unknown = max(one - occupied - free, zero)
    seen_unknown = one - seen_occupied - seen_free
    agreed_occupied = occupied * seen_unknown + unknown * seen_occupied + occupied * seen_occupied
    agreed_free = free * seen_unknown + unknown * seen_free + free * seen_free
    agreed = agreed_occupied + agreed_free + unknown * seen_unknown
    # Certainty against certainty: the rule has no answer, and the newer one stands.
    certain = agreed > 0
    return (
        agreed_occupied / agreed if certain else seen_occupied,
        agreed_free / agreed if certain else seen_free,
    )


@njit(nogil=True)
def _fuse(posterior, prior, label, shift_i, shift_j, table, alpha):  # type: ignore[no-untyped-def]
    H, W = label.shape
    for i in range(H):
        for j in range(W):
            occupied, free = np.float32(0), np.float32(0)
            si, sj = i + shift_i, j + shift_j
            if 0 <= si < H and 0 <= sj < W:
                occupied, free = aged(prior[0, si, sj], prior[1, si, sj], alpha)
            seen = label[i, j]
            posterior[0, i, j], posterior[1, i, j] = combined(occupied, free, table[seen, 0], table[seen, 1])
