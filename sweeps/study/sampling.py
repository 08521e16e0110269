"""Samplers and pruners of a study, by name; what a trial draws depends on the seed, its number and what was before."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from optuna import Study
from optuna.distributions import BaseDistribution
from optuna.pruners import BasePruner, HyperbandPruner, MedianPruner, NopPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial

from ..runs.progress import RUNGS

SamplerName = Literal["tpe", "random"]
PrunerName = Literal["median", "hyperband", "none"]

SAMPLERS: dict[str, Callable[[int], BaseSampler]] = {
    "tpe": lambda seed: TPESampler(seed=seed),
    "random": lambda seed: RandomSampler(seed=seed),
}


class SeededByTrial(BaseSampler):
    """A sampler that starts afresh for each trial, seeded with `seed` and the trial's number.

    Workers that join a study thus never draw the same trials, and a study that was interrupted goes on as one that was
    not.  The first trial draws what `first` says, name -> value: the configuration that all start from, which the best
    one is to beat.
    """

    def __init__(self, make: Callable[[int], BaseSampler], seed: int, first: Mapping[str, Any]) -> None:
        self.make, self.seed, self.first = make, seed, first
        self.sampler = make(seed)

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        random = np.random.SeedSequence([self.seed, trial.number])
        self.sampler = self.make(int(random.generate_state(1)[0]))
        self.sampler.before_trial(study, trial)

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        return {} if trial.number == 0 else self.sampler.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        return self.sampler.sample_relative(study, trial, search_space)

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        if trial.number == 0 and param_name in self.first:
            return self.first[param_name]
        return self.sampler.sample_independent(study, trial, param_name, param_distribution)


def sampler(name: SamplerName, seed: int, first: Mapping[str, Any] | None = None) -> BaseSampler:
    """The sampler of that name; the first trial draws the values `first`."""
    return SeededByTrial(SAMPLERS[name], seed, first or {})


def pruner(name: PrunerName) -> BasePruner:
    """The pruner of that name, for errors reported at the tenths of a schedule.

    The median waits for the second half: the first is mostly stage t+1, whose forecasts say little of the last one's.
    """
    if name == "median":
        return MedianPruner(n_startup_trials=5, n_warmup_steps=RUNGS // 2)
    if name == "hyperband":
        return HyperbandPruner(min_resource=1, max_resource=RUNGS, reduction_factor=3)
    return NopPruner()
