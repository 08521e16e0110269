"""What all metrics share: a few numbers per test window, kept so that means are right in one process and in many."""

import re
from math import isfinite
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torchmetrics import Metric

from envpred.metrics.about import About, Direction

ANONYMOUS = -1  # the index of a window that has none: never taken for a duplicate
LARGEST_INDEX = 2**24  # float32, the type of the state, holds whole numbers exactly up to here


class Judged(NamedTuple):
    """All that a metric may look at of a batch, in float32 and bool, and uint8 for the label.

    Args:
        forecast: (B, N, H, W) probability of occupied.
        target: (B, N, H, W).
        last: (B, H, W) the last grid shown; NaN where it is not told.
        samples: (B, K, N, H, W) equally likely futures, of a forecaster that draws some.
        label: (B, N, H, W) uint8 codes of what was measured in the target frames; unknown where it is not told.
        changed: (B, N, H, W) cells measured in the last frame shown and in the target's, occupied in one of them; none
            where it is not told, here and below.
        static: (B, N, H, W) cells measured in both, and the same; where boxes say what moves, apart from that.
        moving: (B, N, H, W) cells around what moves.
        entering: (B, N, H, W) cells that the last grid shown does not cover.
        mass: (B, N, H, W) the target's mass of occupied; NaN where it is not told.
    """

    forecast: Tensor
    target: Tensor
    last: Tensor
    samples: Tensor | None
    label: Tensor
    changed: Tensor
    static: Tensor
    moving: Tensor
    entering: Tensor
    mass: Tensor


class PerHorizon:
    """A metric over windows: `mean` and `standard_error` (N,), `per_window` (W, N) and the windows' `index` (W,).

    Undefined values (no such cell in that window) are NaN; `about` says how they are written.  Not a tuple or
    dataclass: torchmetrics would turn the tensors of one element inside it (one window, one horizon) into scalars.
    """

    def __init__(self, mean: Tensor, standard_error: Tensor, per_window: Tensor, index: Tensor, about: About) -> None:
        self.mean, self.standard_error, self.per_window, self.index = mean, standard_error, per_window, index
        self.about = about

    def as_json(self) -> dict[str, Any]:
        """Lists for a result file, None where a value is undefined (JSON has no NaN), and how they are written."""
        return {
            **self.about._asdict(),
            "mean": without_nan(self.mean.tolist()),
            "standard_error": without_nan(self.standard_error.tolist()),
            "per_window": [without_nan(row) for row in self.per_window.tolist()],
        }


def without_nan(values: list[float]) -> list[float | None]:
    """`values` with None in place of what is not finite."""
    return [value if isfinite(value) else None for value in values]


def summarise(per_window: Tensor, index: Tensor, about: About, skip_undefined: bool = False) -> PerHorizon:
    """Mean and standard error (sample standard deviation / sqrt(n)) of `per_window` (W, N), windows `index` (W,).

    With `skip_undefined` NaN means "undefined in this window" and n counts the others; without, NaN is passed on.
    The standard error of fewer than two windows is NaN.
    """
    values = per_window.double()
    counted = ~values.isnan() if skip_undefined else torch.ones_like(values, dtype=torch.bool)
    n = counted.sum(0)
    mean = values.where(counted, 0.0).sum(0) / n
    squares = (values - mean).where(counted, 0.0).square().sum(0)
    # (n - 1).clamp: one window has no spread, 0/0 = NaN rather than 0/-1.
    error = (squares / (n - 1).clamp(min=0)).sqrt() / n.sqrt()
    return PerHorizon(mean, error, values, index, about)


class WindowMetric(Metric):
    """Base of the metrics: `measure` or `judge` gives `width` numbers a window, which are all that is kept.

    `update(forecast (B, N, H, W), target (B, N, H, W), last (B, H, W) | None, index (B,) | None)` takes probabilities
    of occupied; `last` is the last grid shown, and what else is told is in `Judged`, for metrics that override `judge`
    instead of `measure`.
    `index` is the window's place in the test set: a distributed sampler pads with windows it has already given, and
    `rows` drops them by it.  Memory: 4 * (width + 1) bytes a window.

    What stands on the class: `name`, the key in a result (by default that of the class: `FalseAlarms` ->
    `false_alarms`), `title` (by default the class's name), `unit`, `digits`, `factor` and `direction` as in `About`;
    torchmetrics' `higher_is_better`, which must agree with `direction` (None for a number); `rewards`, one sentence on
    what a forecast has to do to look good by it; `needs_last`; `needs_label` if it judges by what was measured;
    `needs_cells` if it wants the kinds of cells.
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better: bool | None = False
    needs_last = False
    needs_label = False
    needs_cells = False
    name: ClassVar[str]
    title: ClassVar[str]
    unit: ClassVar[str] = ""
    digits: ClassVar[int] = 3
    factor: ClassVar[float] = 1.0
    direction: ClassVar[Direction] = "lower"
    rewards: ClassVar[str] = ""

    rows_state: list[Tensor] | Tensor

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        named = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__.lstrip("_"))
        cls.name = cls.__dict__.get("name", named.lower())
        cls.title = cls.__dict__.get("title", named.replace("_", " "))
        if cls.higher_is_better != {"lower": False, "higher": True}.get(str(cls.direction)):
            raise TypeError(
                f"{cls.__name__}: direction {cls.direction!r} and higher_is_better {cls.higher_is_better} disagree"
            )

    def __init__(self, horizons: int = 15, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        if horizons < 1:
            raise ValueError(f"a forecast has at least one horizon, not {horizons}")
        self.horizons = horizons
        # One flat float32 state: torchmetrics fills in a flat float32 for a process that saw no window, and tensors
        # gathered from several processes must agree in dimensions and type.
        self.add_state("rows_state", default=[], dist_reduce_fx="cat")

    @property
    def width(self) -> int:
        """Numbers kept per window."""
        return self.horizons

    @property
    def outputs(self) -> tuple[str, ...]:
        """Keys of a result that it gives."""
        return (self.name,)

    @property
    def about(self) -> About:
        """How its values are written."""
        return About(self.title, self.unit, self.digits, self.factor, self.direction, self.rewards)

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        """(B, width) of `forecast` and `target` (B, N, H, W) and `last` (B, H, W), all float32."""
        raise NotImplementedError(f"{type(self).__name__} has neither a `measure` nor a `judge` of its own")

    def judge(self, judged: Judged) -> Tensor:
        """(B, width) of all that is told of a batch; by default what `measure` says."""
        return self.measure(judged.forecast, judged.target, judged.last)

    def update(
        self,
        forecast: Tensor,
        target: Tensor,
        last: Tensor | None = None,
        index: Tensor | None = None,
        samples: Tensor | None = None,
        label: Tensor | None = None,
        changed: Tensor | None = None,
        static: Tensor | None = None,
        moving: Tensor | None = None,
        entering: Tensor | None = None,
        mass: Tensor | None = None,
    ) -> None:
        """Measure a batch of windows; see the class."""
        if forecast.shape != target.shape or forecast.ndim != 4 or forecast.shape[1] != self.horizons:
            raise ValueError(
                f"forecast {tuple(forecast.shape)} and target {tuple(target.shape)} must both be "
                f"(B, {self.horizons}, H, W)"
            )
        windows, _, height, width = forecast.shape
        if last is None:
            if self.needs_last:
                raise ValueError(f"{type(self).__name__} needs `last`, the last grid shown")
            last = target.new_full((windows, height, width), float("nan"))
        elif last.shape != (windows, height, width):
            raise ValueError(f"last {tuple(last.shape)} must be {(windows, height, width)}")
        if index is None:
            index = torch.full((windows,), ANONYMOUS, device=forecast.device)
        elif index.shape != (windows,) or (index >= LARGEST_INDEX).any():
            raise ValueError(f"index {tuple(index.shape)} must be ({windows},) and below {LARGEST_INDEX}")
        if samples is not None and (samples.ndim != 5 or (samples[:, 0].shape != forecast.shape)):
            raise ValueError(f"samples {tuple(samples.shape)} must be (B, K, N, H, W) of forecasts {forecast.shape}")
        if label is None and self.needs_label:
            raise ValueError(f"{type(self).__name__} needs `label`, what was measured in the target frames")
        told = {"changed": changed, "static": static, "moving": moving, "entering": entering}
        cells = {name: _told(name, grid, forecast, torch.bool) for name, grid in told.items()}
        label = _told("label", label, forecast, torch.uint8)
        forecast, target, last = (grid.detach().float() for grid in (forecast, target, last))
        drawn = None if samples is None else samples.detach().float()
        if mass is None:
            mass = torch.full_like(target, float("nan"))
        elif mass.shape != target.shape:
            raise ValueError(f"mass {tuple(mass.shape)} must be {tuple(target.shape)}")
        measured = self.judge(Judged(forecast, target, last, drawn, label, **cells, mass=mass.detach().float()))
        rows = torch.cat([index.to(measured.device, torch.float32)[:, None], measured.float()], dim=1)
        assert isinstance(self.rows_state, list)
        self.rows_state.append(rows.flatten())

    def rows(self) -> tuple[Tensor, Tensor]:
        """(index (W,) int64, values (W, width)) of all windows seen, each once, in the order of their index."""
        state = self.rows_state
        flat = state if isinstance(state, Tensor) else torch.cat([*state, torch.empty(0, device=self.device)])
        rows = flat.reshape(-1, self.width + 1)
        index = rows[:, 0].long()
        order = torch.argsort(index, stable=True)
        index, values = index[order], rows[order, 1:]
        fresh = torch.ones_like(index, dtype=torch.bool)
        fresh[1:] = (index[1:] != index[:-1]) | (index[1:] == ANONYMOUS)
        return index[fresh], values[fresh]


def _told(name: str, grid: Tensor | None, forecast: Tensor, kind: torch.dtype) -> Tensor:
    """The `grid` of that name, as large as the forecast and of its `kind`; zeros where it is not told."""
    if grid is None:
        return torch.zeros_like(forecast, dtype=kind)
    if grid.shape != forecast.shape or grid.dtype != kind:
        wanted = f"{str(kind).removeprefix('torch.')} {tuple(forecast.shape)}"
        raise ValueError(f"{name} {tuple(grid.shape)} of {grid.dtype} must be {wanted}")
    return grid


class HorizonMetric(WindowMetric):
    """A metric that is one number per window and horizon; `compute()` gives `PerHorizon`."""

    skip_undefined = False

    def compute(self) -> PerHorizon:
        """Mean and standard error over all windows seen in all processes, and the windows' own values."""
        index, values = self.rows()
        return summarise(values, index, self.about, self.skip_undefined)
