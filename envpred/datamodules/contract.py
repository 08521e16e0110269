"""What passes between a data module and a forecaster: what it needs, what it sees, what came then, what it forecasts.

These are kept apart, so that nothing later than the last frame shown can reach a forecast: `Seen` does not hold it.
The idea is that of the task and predictor of GraphCast (Lam et al. 2023).
"""

from typing import Literal, NamedTuple, NotRequired, TypedDict

from torch import Tensor

# What a method is, for tables, curves and pictures; a name alone never decides.
Role = Literal["static", "moved", "particle", "rollout", "learned", "oracle"]


class Needs(NamedTuple):
    """What a forecaster reads beside the frames of its variant, as a class attribute `needs`.

    Args:
        arrays: names of stored arrays.
        context: the frames of the wide grid too.
        future_pose: the ego's true motion over the frames to be forecast; for oracles alone.
    """

    arrays: tuple[str, ...] = ()
    context: bool = False
    future_pose: bool = False


class Seen(TypedDict):
    """What a forecaster sees of a batch: the frames shown, the last of which is the present.

    Cells lie on the drive's lattice; headings are in radians, counter-clockwise from east.
    """

    frames: Tensor  # (B, given, C, H, W) the variant's channels
    occupancy: Tensor  # (B, given, H, W) pignistic probability of occupied
    label: Tensor  # (B, given, H, W) uint8 codes of the label grids
    centre_cell: Tensor  # (B, given, 2) lattice cell at each grid's centre
    pose: Tensor  # (B, given, 3) x and y in cells of the lattice, heading
    time: Tensor  # (B, given) seconds, 0 at the last frame shown
    sensor: Tensor  # (B, 3) pose of the sensor in the body frame: metres ahead and to the left, heading
    body: Tensor  # (B, 3) rear, front and half width of the ego's body in the sensor frame, metres
    resolution: Tensor  # (B,) side of a cell in metres
    period: Tensor  # (B,) seconds between frames
    arrays: dict[str, Tensor]  # name -> (B, given, ...) what `Needs.arrays` names
    context: NotRequired[Tensor]  # (B, given, C, H', W') the variant's channels on the wide grid
    context_label: NotRequired[Tensor]  # (B, given, H', W') uint8
    future_pose: NotRequired[Tensor]  # (B, N, 3) as `pose`; oracles alone
    future_centre_cell: NotRequired[Tensor]  # (B, N, 2) as `centre_cell`; oracles alone


class Future(TypedDict):
    """What came after the frames shown: what forecasts are trained towards and judged by."""

    frames: Tensor  # (B, N, C, H, W)
    occupancy: Tensor  # (B, N, H, W) the probability of occupied that is judged
    occupied_mass: Tensor  # (B, N, H, W) the mass of occupied in it, without its half of what is unknown
    label: Tensor  # (B, N, H, W) uint8
    centre_cell: Tensor  # (B, N, 2)
    pose: Tensor  # (B, N, 3)
    moving: NotRequired[Tensor]  # (B, N, H, W) uint8 of `envpred.mapping.boxes`, where boxes say what moves


class WindowBatch(TypedDict):
    """A batch of windows; `future` is None where there are no targets."""

    seen: Seen
    future: Future | None
    drive: list[str]
    start: Tensor  # (B,) position of the first frame in the drive's arrays
    index: Tensor  # (B,) place of the window in its data set, by which metrics tell duplicates


class Forecast(NamedTuple):
    """What a forecaster says of the N frames to come, each in the ego's grid of that frame.

    Args:
        probability: (B, N, H, W) probability of occupied in [0, 1], what is judged.
        channels: (B, N, C, H, W) the variant's channels, if it forecasts them all.
        samples: (B, K, N, H, W) equally likely futures, if it draws some; `probability` is about their mean, and may
            know better (as the rollout, which weighs its ego futures).
    """

    probability: Tensor
    channels: Tensor | None = None
    samples: Tensor | None = None
