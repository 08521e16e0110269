"""Weights of the hit rates: maximum likelihood of the labels that came later, on drives that count alike."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from envpred.mapping.evidence import Mass
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, FloatArray
from envpred.mapping.hit_rates import NUMBERS, SHOWN, HitRates, conditions, features, ranged

HORIZONS = (1, 2, 3, 5, 8, 10, 12, 15)  # frames ahead that examples are taken at


class Examples(NamedTuple):
    """Cells of one drive, drawn, with what came of them."""

    inputs: NDArray[np.float32]  # (M, 105)
    label: NDArray[np.uint8]  # (M,) the label code that the cell had later
    weight: NDArray[np.float32]  # (M,) cells that an example stands for; sums to 1


def examples(
    labels: NDArray[np.uint8],
    masses: Mass,
    centre_cells: NDArray[np.integer],
    poses: FloatArray,
    resolution: float,
    cells: int,
    generator: np.random.Generator,
    every: int = 8,
    share: float = 0.2,
    empty_share: float = 0.03,
    period: float = 0.1,
) -> Examples:
    """Draw examples from one drive without a gap.

    Args:
        labels: (T, W, W) label codes in the context grid.
        masses: (T, 2, W, W) masses in the context grid.
        centre_cells: (T, 2) lattice cells at the centres.
        poses: (T, 3) in cells and radians.
        resolution: a cell's side, metres.
        cells: of the judged grid's side; cells that it covers later are drawn.
        generator: source of randomness.
        every: frames between those from which examples look ahead.
        share: of the cells with something in or around them that are drawn.
        empty_share: of the others.
        period: seconds between frames.
    """
    W = labels.shape[-1]
    inputs, outcomes, weights = [], [], []
    for last in range(SHOWN - 1, len(labels) - max(HORIZONS), every):
        frames = slice(last - SHOWN + 1, last + 1)
        found = features(labels[frames], centre_cells[frames], np.asarray(masses[last]), (0, 0, W, W))
        busy = (found[1:6].sum(axis=0) + found[18] + (found[11] > 0.05)) > 0
        ahead = conditions(poses[last + 1 : last + 1 + max(HORIZONS)], poses[last], resolution, period)
        for h in HORIZONS:
            i, j = np.indices((W, W)) + (np.asarray(centre_cells[last], np.int64) - W // 2)[:, None, None]
            u, v = np.stack([i, j]) - np.asarray(centre_cells[last + h], np.int64)[:, None, None]
            judged = (np.maximum(u, v) < cells // 2) & (np.minimum(u, v) >= -(cells // 2))
            chance = np.where(busy, share, empty_share) * judged
            drawn = generator.random((W, W)) < chance
            later = labels[last + h][u[drawn] + W // 2, v[drawn] + W // 2]
            use = later != EGO
            here, then = (
                np.hypot(i[drawn] - poses[t, 0], j[drawn] - poses[t, 1])[use] * resolution for t in (last, last + h)
            )
            inputs.append(_design(found[:, drawn][:, use], here, then, ahead[h - 1]))
            outcomes.append(later[use])
            weights.append(1 / chance[drawn][use])
    weight = np.concatenate(weights)
    return Examples(np.concatenate(inputs), np.concatenate(outcomes), (weight / weight.sum()).astype(np.float32))


def fit(drives: Sequence[Examples], weights: Sequence[float] | None = None, rounds: int = 80) -> HitRates:
    """Hit rates of the largest likelihood on `drives`, each counting by its weight (by default alike)."""
    weights = [1.0] * len(drives) if weights is None else weights
    return HitRates(*(_logistic(drives, weights, seen, rounds) for seen in (False, True)))


def log_loss(rates: HitRates, drive: Examples) -> tuple[float, float]:
    """Mean negative log-likelihood on `drive` of its hits, and of what is seen free among the rest."""
    losses = []
    for seen, theta in ((False, rates.hit), (True, rates.seen)):
        inputs, target, weight = _of(drive, seen)
        score = inputs @ theta
        losses.append(float(np.average(np.logaddexp(0, score) - target * score, weights=weight)))
    return losses[0], losses[1]


def _design(
    found: NDArray[np.float32], here: FloatArray, then: FloatArray, ahead: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Inputs (M, 105) of cells with features `found` (22, M), ranges in metres, and the horizon's conditions (3,)."""
    a, b = here / 20, then / 20
    some = ranged(found)
    parts = [found, *(found * c for c in ahead), [a, b, a * a, b * b, a * b], some * b, some * (a - b)]
    design = np.concatenate([np.asarray(p, np.float32) for p in parts]).T
    assert design.shape[1] == NUMBERS
    return np.ascontiguousarray(design)


def _of(drive: Examples, seen: bool) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Inputs, outcomes (0 or 1) and weights of one of the two models."""
    if not seen:
        return drive.inputs, (drive.label == OCCUPIED).astype(np.float32), drive.weight
    rest = drive.label != OCCUPIED
    return drive.inputs[rest], (drive.label[rest] == FREE).astype(np.float32), drive.weight[rest]


def _logistic(drives: Sequence[Examples], weights: Sequence[float], seen: bool, rounds: int) -> FloatArray:
    """Weights (105,) of logistic regression, lightly drawn towards 0 (L-BFGS)."""
    chosen = [_of(drive, seen) for drive in drives]
    inputs, target = (torch.from_numpy(np.concatenate([c[k] for c in chosen])) for k in (0, 1))
    weight = torch.from_numpy(np.concatenate([c[2] / c[2].sum() * w for c, w in zip(chosen, weights, strict=True)]))
    weight = weight / weight.sum()
    scale = inputs.std(0) + 1e-3
    scale[0] = 1  # the constant feature
    theta = torch.zeros(NUMBERS, requires_grad=True)
    optimizer = torch.optim.LBFGS([theta], max_iter=rounds, history_size=20, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimizer.zero_grad()
        score = inputs @ (theta / scale)
        entropy = torch.nn.functional.binary_cross_entropy_with_logits(score, target, reduction="none")
        value = (weight * entropy).sum() + 1e-7 * theta.square().sum()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimizer.step(loss)  # type: ignore[no-untyped-call]
    result: FloatArray = (theta / scale).detach().double().numpy()
    return result
