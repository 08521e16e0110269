"""Image similarity of occupancy maps: how far each class of cell lies from its like in the other map."""

from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.compiled import njit
from envpred.metrics.windows import PerHorizon, WindowMetric, summarise

CLASSES = ("occupied", "free", "unknown")
OCCUPIED_FROM, FREE_BELOW = 0.85, 0.20
Empty = Literal["penalty", "zero"]


@njit()
def class_of(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Place in CLASSES of each cell (H, W): occupied p >= 0.85, free p < 0.20, unknown between."""
    classes = np.full(probability.shape, 2, np.uint8)
    for i in range(probability.shape[0]):
        for j in range(probability.shape[1]):
            if probability[i, j] >= np.float32(OCCUPIED_FROM):
                classes[i, j] = 0
            elif probability[i, j] < np.float32(FREE_BELOW):
                classes[i, j] = 1
    return classes


@njit()
def distances(classes: NDArray[np.uint8], wanted: int) -> NDArray[np.int32]:
    """Exact L1 distance (H, W) in cells from each cell of `classes` to the nearest of class `wanted`; one must exist.

    Separable: the distance within each row, then the least of a row's own and its neighbour row's plus one, down and up
    (Rosenfeld and Pfaltz 1966).  scipy's `distance_transform_cdt` gives the same in several times the time, which would
    be half of what all metrics cost.
    """
    height, width = classes.shape
    distance = np.empty((height, width), np.int32)
    for i in range(height):
        nearest = np.int32(height + width)
        for j in range(width):
            nearest = np.int32(0) if classes[i, j] == wanted else nearest + np.int32(1)
            distance[i, j] = nearest
        nearest = np.int32(height + width)
        for j in range(width - 1, -1, -1):
            nearest = np.int32(0) if classes[i, j] == wanted else nearest + np.int32(1)
            distance[i, j] = min(distance[i, j], nearest)
    for i in range(1, height):
        for j in range(width):
            distance[i, j] = min(distance[i, j], distance[i - 1, j] + np.int32(1))
    for i in range(height - 2, -1, -1):
        for j in range(width):
            distance[i, j] = min(distance[i, j], distance[i + 1, j] + np.int32(1))
    return distance


@njit()
def directed(from_map: NDArray[np.uint8], to_map: NDArray[np.uint8], wanted: int) -> float:
    """d(a, b, c): mean over the cells of class `wanted` in `from_map` of the distance to the nearest in `to_map`."""
    distance = distances(to_map, wanted)
    total = count = 0
    for i in range(from_map.shape[0]):
        for j in range(from_map.shape[1]):
            if from_map[i, j] == wanted:
                total += distance[i, j]
                count += 1
    return total / count


@njit()
def image_similarity(
    forecast: NDArray[np.float32], target: NDArray[np.float32], both_lack: float
) -> NDArray[np.float64]:
    """psi_c of each class (N, 3) between N pairs of maps (N, H, W); their sum is the image similarity.

    psi_c = d(a, b, c) + d(b, a, c), where d(a, b, c) is the mean over the cells of class c in a of the L1 distance in
    cells to the nearest cell of class c in b (Birk and Carpin 2006, equations 3 and 4).  0 = the same; lower is better.
    A class that one map lacks costs 2 (H + W), one that both lack `both_lack`.
    """
    psi = np.empty((len(forecast), 3))
    for n in range(len(forecast)):
        a, b = class_of(forecast[n]), class_of(target[n])
        for c in range(3):
            in_a, in_b = (a == c).any(), (b == c).any()
            if in_a and in_b:
                psi[n, c] = directed(a, b, c) + directed(b, a, c)
            else:
                psi[n, c] = 2.0 * (a.shape[0] + a.shape[1]) if in_a or in_b else both_lack
    return psi


class ImageSimilarity(WindowMetric):
    """Image similarity per horizon, summed (`image_similarity`) and of each class (`image_similarity_occupied`, ...).

    A class that both maps lack costs 2 (H + W) in the widely used code (`empty="penalty"`), nothing in a later variant
    (`"zero"`).

    >>> import torch
    >>> target = torch.zeros(1, 1, 8, 8)
    >>> target[..., 2, 2], target[..., 0, 0] = 1.0, 0.5
    >>> metric = ImageSimilarity(horizons=1)
    >>> metric.update(target.roll(3, dims=-1), target)
    >>> metric.compute()["image_similarity_occupied"].mean.item()  # a cell moved by 3: 3 in both directions
    6.0
    """

    title = "Image similarity"
    unit = "cells"
    digits = 2
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards sure cells near like cells, and sharp pictures: blur leaves no sure cell."

    def __init__(self, horizons: int = 15, empty: Empty = "penalty", **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if empty not in ("penalty", "zero"):
            raise ValueError(f"empty is 'penalty' or 'zero', not {empty!r}")
        self.empty: Empty = empty

    @property
    def outputs(self) -> tuple[str, ...]:
        return (self.name, *(f"{self.name}_{name}" for name in CLASSES))

    @property
    def width(self) -> int:
        return len(CLASSES) * self.horizons

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        both_lack = 0.0 if self.empty == "zero" else 2.0 * sum(target.shape[-2:])
        psi = image_similarity(forecast.flatten(0, 1).cpu().numpy(), target.flatten(0, 1).cpu().numpy(), both_lack)
        return torch.from_numpy(psi).view(len(forecast), self.width).to(forecast.device)

    def compute(self) -> dict[str, PerHorizon]:
        """The sum and the three classes over all windows seen in all processes."""
        index, values = self.rows()
        psi = values.view(-1, self.horizons, len(CLASSES)).double()
        titles = (self.title, *(f"{self.title}, {name}" for name in CLASSES))
        parts = (psi.sum(-1), *psi.unbind(-1))
        return {
            name: summarise(value, index, self.about._replace(title=title))
            for name, title, value in zip(self.outputs, titles, parts, strict=True)
        }
