"""The search space: YAML keyed by the dotted argument of `envpred fit`.

    config: prednet                         # what runs start from unless --config says otherwise
    model.t1_lr: {type: float, low: 1.0e-5, high: 1.0e-2, log: true}
    model.t1_epochs: {type: int, low: 1, high: 8}
    model.channels: {choices: [[8, 16], [16, 32], [16, 32, 64]]}
    model.layer_weights: {list: [1.0, {type: float, low: 0.01, high: 1.0, log: true}]}
    trainer.gradient_clip_val: {type: float, low: 0.1, high: 10, log: true, when: {data.batch_size: [1, 2]}}

A `list` is searched element by element, and `when` names values of arguments further up, without which the argument
stays as the configuration has it.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    check_distribution_compatibility,
)

from envpred.cli.arguments import FitArguments
from envpred.cli.shipped import COMPLETE, find
from envpred.errors import UserError, nearest, one_line, printable, short
from envpred.gate import conform, read_yaml
from envpred.store import digest

from ..runs.command import FIXED

CONFIG = "config"
KEYS = ("type", "low", "high", "log", "step", "choices", "list", "when")
NUMBERS = {"float": float, "int": int}


@dataclass(frozen=True)
class Dimension:
    """One number or choice that is searched: Optuna's name of it and its distribution."""

    name: str
    distribution: BaseDistribution

    def suggest(self, trial: optuna.Trial) -> Any:
        """The value that the study's sampler gives `trial`."""
        match self.distribution:
            case FloatDistribution(low=low, high=high, log=log, step=step):
                return trial.suggest_float(self.name, low, high, log=log, step=step)
            case IntDistribution(low=low, high=high, log=log, step=step):
                return trial.suggest_int(self.name, low, high, log=log, step=step)
            case CategoricalDistribution(choices=choices):
                return decoded(trial.suggest_categorical(self.name, choices))
        raise ValueError(f"no distribution of ours: {self.distribution}")

    def holds(self, value: Any) -> bool:
        """Whether a value is in its range or among its choices."""
        match self.distribution:
            case CategoricalDistribution(choices=choices):
                return encoded(value) in choices
            case FloatDistribution(low=low, high=high) | IntDistribution(low=low, high=high):
                return isinstance(value, int | float) and low <= value <= high
        raise ValueError(f"no distribution of ours: {self.distribution}")

    def samples(self) -> list[Any]:
        """The ends of its range, or every choice: what the command line must take."""
        match self.distribution:
            case CategoricalDistribution(choices=choices):
                return [decoded(choice) for choice in choices]
            case FloatDistribution(low=low, high=high) | IntDistribution(low=low, high=high):
                return [low, high]
        raise ValueError(f"no distribution of ours: {self.distribution}")


@dataclass(frozen=True)
class Entry:
    """An argument of the space: one dimension, or a list of dimensions and constants; and when it is searched."""

    value: Any  # a Dimension, or a list whose elements are Dimensions or constants
    when: Mapping[str, list[Any]]

    @property
    def dimensions(self) -> list[Dimension]:
        parts = self.value if isinstance(self.value, list) else [self.value]
        return [part for part in parts if isinstance(part, Dimension)]

    def suggest(self, trial: optuna.Trial) -> Any:
        """The argument's value in `trial`."""
        if isinstance(self.value, list):
            return [part.suggest(trial) if isinstance(part, Dimension) else part for part in self.value]
        return self.value.suggest(trial)

    def sample(self, place: int) -> Any:
        """The value made of the `place`-th sample of each dimension."""

        def of(part: Any) -> Any:
            return part.samples()[min(place, len(part.samples()) - 1)] if isinstance(part, Dimension) else part

        return [of(part) for part in self.value] if isinstance(self.value, list) else of(self.value)


@dataclass(frozen=True)
class Space:
    """A search space, read from `file`; `config` is the configuration that it was written for, if it names one."""

    file: Path
    config: list[Path]
    entries: Mapping[str, Entry]

    @property
    def hash(self) -> str:
        """What tells it from another space: its arguments, in their order, and what is searched of them."""
        return digest([(name, str(entry.value), sorted(entry.when.items())) for name, entry in self.entries.items()])

    def suggest(self, trial: optuna.Trial) -> dict[str, Any]:
        """The arguments (dotted name -> value) of `trial`; those whose conditions do not hold are left out."""
        chosen: dict[str, Any] = {}
        for name, entry in self.entries.items():
            if all(other in chosen and chosen[other] in values for other, values in entry.when.items()):
                chosen[name] = entry.suggest(trial)
        return chosen

    def values_in(self, fit: FitArguments) -> dict[str, Any]:
        """The values (Optuna's name -> value) that the configuration has, of those that the space holds.

        Elements that a list of the configuration lacks count as 0, as those of layer weights do.
        """
        given = fit.values
        found: dict[str, Any] = {}
        for name, entry in self.entries.items():
            value = given[name.replace(".init_args.", ".")]
            if isinstance(entry.value, list):
                whole = [*value, *[0] * (len(entry.value) - len(value))] if isinstance(value, list) else []
                pairs = [(d, v) for d, v in zip(entry.value, whole, strict=False) if isinstance(d, Dimension)]
            else:
                pairs = [(entry.value, value)]
            found |= {d.name: encoded(v) for d, v in pairs if d.holds(v)}
        return found

    def check_joins(self, study: optuna.Study) -> None:
        """Refuse a study whose trials drew the same names from what Optuna cannot bring together with ours.

        Raises:
            UserError: naming the argument.
        """
        ours = {d.name: d.distribution for entry in self.entries.values() for d in entry.dimensions}
        for trial in study.get_trials(deepcopy=False):
            for name, theirs in trial.distributions.items():
                try:
                    check_distribution_compatibility(theirs, ours.get(name, theirs))
                except ValueError as error:
                    raise UserError(
                        f"{self.file}: {name} was searched otherwise in trial {trial.number} of the study "
                        f"{study.study_name} ({error}); give another --name"
                    ) from None

    def check(self, fit: FitArguments) -> None:
        """Refuse, before the first trial, what `envpred fit` would refuse: names, and the ends of every range.

        Raises:
            UserError: naming the argument, and the nearest right name.
        """
        fit.check_names(self.entries, str(self.file))
        for name in self.entries:
            if name in {f"data.{fixed}" for fixed in FIXED} or name.startswith("trainer.logger"):
                raise UserError(f"{self.file}: {name} cannot be searched: trials are compared on the same windows")
        rounds = max(len(d.samples()) for entry in self.entries.values() for d in entry.dimensions)
        for place in range(rounds):
            try:
                fit.complete({name: entry.sample(place) for name, entry in self.entries.items()})
            except UserError as error:
                raise UserError(f"{self.file}: {error}") from None


def read_space(given: str | Path) -> Space:
    """The search space of a YAML file, or that of a name that ships.

    Raises:
        UserError: naming the argument that cannot be read, and why.
    """
    file = find(str(given), ("space",), "--space")
    content = read_yaml(file, "mend it")
    if not isinstance(content, dict) or not set(content) - {CONFIG}:
        raise UserError(
            f"{file}: names no argument to search; write lines such as `model.t1_lr: {{low: ..., high: ...}}`"
        )
    named = conform(content.pop(CONFIG, []), str | list[str], f"{file}: {CONFIG}", "name configurations there")
    configs = named if isinstance(named, list) else [named]
    config = [find(name, COMPLETE, f"{file}: {CONFIG}", file) for name in configs]
    entries: dict[str, Entry] = {}
    for name, text in content.items():
        try:
            entries[str(name)] = _entry(str(name), text, list(entries))
        except ValueError as error:
            raise UserError(f"{file}: {printable(str(name))}: {one_line(error)}") from None
    return Space(file, config, entries)


def encoded(value: Any) -> Any:
    """`value` as a choice of Optuna's, whose storages take no lists: those are written as JSON."""
    return json.dumps(value) if isinstance(value, list) else value


def decoded(choice: Any) -> Any:
    """The value that a choice stands for, see `encoded`."""
    return json.loads(choice) if isinstance(choice, str) and choice.startswith("[") else choice


def _entry(name: str, text: Any, earlier: list[str]) -> Entry:
    _check_keys(text)
    if "list" in text:
        if not isinstance(text["list"], list) or not text["list"]:
            raise ValueError("`list` takes the list's elements: constants, or ranges and choices of their own")
        elements = [_dimension(f"{name}.{k}", e) if isinstance(e, dict) else e for k, e in enumerate(text["list"])]
        value: Any = elements
        if not any(isinstance(element, Dimension) for element in elements):
            raise ValueError("`list` holds constants alone; that is no search")
    else:
        value = _dimension(name, text)
    when = text.get("when") or {}
    if not isinstance(when, dict):
        raise ValueError("`when` takes arguments with the values that they must have")
    for other in when:
        if other not in earlier:
            near = nearest(str(other), earlier)
            hint = f"; did you mean {near}?" if near else ""
            raise ValueError(f"`when` names {other}, which is not searched further up{hint}")
    return Entry(value, {k: v if isinstance(v, list) else [v] for k, v in when.items()})


def _dimension(name: str, text: Any) -> Dimension:
    _check_keys(text)
    if "choices" in text:
        choices = text["choices"]
        if not isinstance(choices, list) or not choices or set(text) & {"low", "high", "log", "step"}:
            raise ValueError("`choices` takes a list of values, and no range beside it")
        return Dimension(name, CategoricalDistribution([encoded(choice) for choice in choices]))
    kind = text.get("type", "float")
    if not isinstance(kind, str) or kind not in NUMBERS:
        raise ValueError(f"type {short(kind)} is neither float nor int; give `choices` for everything else")
    if "low" not in text or "high" not in text:
        raise ValueError("needs `low` and `high`, or `choices`")
    low, high = (_number(text[end], NUMBERS[kind]) for end in ("low", "high"))
    step = None if text.get("step") is None else _number(text["step"], NUMBERS[kind])
    log = bool(text.get("log", False))
    if kind == "int":
        return Dimension(name, IntDistribution(low, high, log, 1 if step is None else step))
    return Dimension(name, FloatDistribution(low, high, log, step))


def _check_keys(text: Any) -> None:
    if not isinstance(text, dict):
        raise ValueError(f"{short(text)} is no range; give `low` and `high`, or `choices`")
    for key in text:
        if key not in KEYS:
            near = nearest(str(key), KEYS)
            hint = f"did you mean {near}?" if near else f"there are {KEYS}"
            raise ValueError(f"unknown key {short(key)}; {hint}")


def _number(value: Any, kind: type[Any]) -> Any:
    """A number; YAML takes 1e-4, without a point, for text."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{short(value)} is no number") from None
    if not math.isfinite(number):
        raise ValueError(f"{short(value)} is no number that ends a range")
    if kind is int and number != int(number):
        raise ValueError(f"{short(value)} is no whole number")
    return kind(number)
