"""The plan of an ablation: which runs there are, on which grids, and which of them a report compares."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from envpred.cli.arguments import FitArguments, as_options
from envpred.cli.tokens import split_arguments
from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError, check_number

from ..runs.command import FIXED
from .rollouts import ROLLOUT, ROWS, UNCHANGED, Row
from .rollouts import options as rollout_options

MAIN = "main"  # the store that the user gave
STATIC, DYNAMIC = "dst_static", "dst_dogma"
VELOCITIES = "velocities"  # the group whose runs read different ones


@dataclass(frozen=True)
class Run:
    """One training and test, or the test of a baseline.

    Args:
        name: of its folder, without its hash.
        groups: reports that it is part of.
        store: key of the store that it reads.
        options: of `envpred fit`, but for the store.
        trains: whether there is something to train.
    """

    name: str
    groups: tuple[str, ...]
    store: str
    options: tuple[str, ...]
    trains: bool = True


@dataclass(frozen=True)
class Switch:
    """One thing that is changed, all else being equal.

    Args:
        question: that it answers, for the reader of the summary.
        group: report of it beside what it is compared with, the unchanged run of `variant`.
        variant: input variant.
        changes: complete configuration of the unchanged run -> arguments that are changed.
        store: key of the store, if it needs another one.
        alone: whether its windows or grids differ, so that only its ratio to the static baseline can be compared.
    """

    question: str
    group: str
    variant: str
    changes: Callable[[Mapping[str, Any]], dict[str, Any]] = lambda config: {}
    store: str = MAIN
    alone: bool = False


def _one_stage(kept: str, left_out: str) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """All epochs in one stage; the learning rate drops as many epochs before the end as it did."""

    def changes(config: Mapping[str, Any]) -> dict[str, Any]:
        model = config["model"]["init_args"]
        more = model[f"{left_out}_epochs"]
        return {
            f"model.{kept}_epochs": model[f"{kept}_epochs"] + more,
            f"model.{kept}_drop_epoch": model[f"{kept}_drop_epoch"] + more,
            f"model.{left_out}_epochs": 0,
        }

    return changes


def _context(given: int) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Other frames shown, as many forecast."""

    def changes(config: Mapping[str, Any]) -> dict[str, Any]:
        length, before = config["data"]["length"], config["data"]["given"]
        return {"data.given": given} | ({} if length is None else {"data.length": length - before + given})

    return changes


SWITCHES = {
    "t1_only": Switch("one stage instead of two: t+1 alone", "network", STATIC, _one_stage("t1", "t5")),
    "t5_only": Switch("one stage instead of two: t+5 alone", "network", STATIC, _one_stage("t5", "t1")),
    "feedback_current": Switch(
        "feedback of the current instead of the stale guess", "network", STATIC, lambda c: {"model.feedback": "current"}
    ),
    "all_scored": Switch(
        "loss of stage t+5 over all frames, as in the paper", "network", STATIC, lambda c: {"model.first_scored": 1}
    ),
    "forecasts_scored": Switch(
        "loss of stage t+5 over forecasts alone",
        "network",
        STATIC,
        lambda c: {"model.first_scored": c["data"]["given"]},
    ),
    "absolute_error": Switch(
        "absolute errors in stage t+5, as in the paper", "network", STATIC, lambda c: {"model.t5_error": "absolute"}
    ),
    "squared_error": Switch("squared errors in stage t+5", "network", STATIC, lambda c: {"model.t5_error": "squared"}),
    "fixed_frame": Switch(
        "the ego's motion told: frames fixed on the last one shown",
        "network",
        STATIC,
        lambda c: {"model.fixed_frame": True},
    ),
    "fixed_context": Switch(
        "the same, and what enters read from the wide grid",
        "network",
        STATIC,
        lambda c: {"model.fixed_frame": True, "model.context": True},
        store=ROLLOUT,
    ),
    "ground_velocity": Switch(
        "velocities relative to the ground (and the filter's numbers for it) instead of the ego",
        VELOCITIES,
        DYNAMIC,
        store="ground_velocity",
    ),
    "fewer_particles": Switch("a tenth of the particles", VELOCITIES, DYNAMIC, store="fewer_particles"),
    "ransac": Switch("RANSAC instead of MRF ground segmentation", "ransac", STATIC, store="ransac", alone=True),
    "context_3": Switch("3 frames shown", "context_3", STATIC, _context(3), alone=True),
    "context_10": Switch("10 frames shown", "context_10", STATIC, _context(10), alone=True),
}  # fmt: skip

# Every name that --switches takes, and what it answers.
QUESTIONS = {name: row.question for name, row in (SWITCHES | ROWS).items()}


def make_plan(
    fit: list[str], tuned: Mapping[str, Path], variants: list[str], switches: list[str], seeds: list[int]
) -> list[Run]:
    """The runs: every variant with each set of hyperparameters and seed, a baseline, then switches and rollouts.

    Args:
        fit: options of `envpred fit` that all start from.
        tuned: variant -> tuned configuration; of `fit`, only what decides the windows and the trainer is set over it.
        variants: input variants of the table.
        switches: names of switches and of the rollout's rows; they are run with the first seed, unless `fit` has them
            so already.
        seeds: of initial weights and training windows.

    Raises:
        UserError: if a variant or switch is not known, or an option would be refused.
    """
    for given, known, what in ((variants, VARIANTS, "variants"), (switches, QUESTIONS, "switches")):
        unknown = [name for name in given if name not in known]
        if unknown or len(set(given)) < len(given):
            raise UserError(f"--{what} {given}: {unknown or 'named twice'}; there are {', '.join(known)}")
    check_seeds(seeds)
    base = ["--model=envpred.models.PredNetForecaster", *fit]
    config = FitArguments([*base, "--data.store=."]).base  # the store is not read here
    judged = _judged(fit, config)
    runs = [
        Run(f"{variant}_{kind}_seed{seed}", ("variants",), MAIN, (*options, *seeded(variant, seed)))
        for variant in variants
        for kind, options in _kinds(base, judged, tuned.get(variant))
        for seed in seeds
    ]
    rolled = [name for name in switches if name in ROWS]
    groups = ("variants", ROLLOUT) if rolled else ("variants",)
    runs.append(Run("moved_last_frame", groups, MAIN, ("--model=envpred.models.MovedLastFrame", *judged), False))
    for name in (name for name in switches if name in SWITCHES):
        switch = SWITCHES[name]
        unchanged = (*base, *seeded(switch.variant, seeds[0]))
        before = FitArguments([*unchanged, "--data.store=."])
        changes = switch.changes(before.base)
        if changes and all(before.values[argument] == value for argument, value in changes.items()):
            continue
        if not switch.alone:
            runs = _with_reference(runs, switch, seeds[0], unchanged)
        runs.append(Run(name, (switch.group,), switch.store, (*unchanged, *as_options(changes))))
    for name in [ROLLOUT, *rolled] if rolled else []:
        runs.append(_rollout(name, ROWS.get(name, UNCHANGED), judged, config, seeds[0]))
    return runs


def _rollout(name: str, row: Row, judged: list[str], config: Mapping[str, Any], seed: int) -> Run:
    """A row of the rollout."""
    options = (*rollout_options(row, judged, config), *seeded(STATIC, seed))
    return Run(name, (ROLLOUT,), ROLLOUT, options, row.trains)


def _with_reference(runs: list[Run], switch: Switch, seed: int, options: tuple[str, ...]) -> list[Run]:
    """`runs` with the unchanged run among the group of the switch."""
    name = f"{switch.variant}_default_seed{seed}"
    if not any(run.name == name for run in runs):
        return [*runs, Run(name, (switch.group,), MAIN, options)]
    return [
        replace(run, groups=(*run.groups, switch.group)) if run.name == name and switch.group not in run.groups else run
        for run in runs
    ]


def _kinds(base: list[str], judged: list[str], tuned: Path | None) -> list[tuple[str, list[str]]]:
    """Default hyperparameters, and tuned ones if there are."""
    found = [("default", base)]
    if tuned is not None:
        found.append(("tuned", [f"--config={tuned}", *judged]))
    return found


def check_seeds(seeds: list[int]) -> None:
    """Refuse seeds of which one could not be a run's, or is there twice, or none at all.

    Raises:
        UserError: naming them.
    """
    for seed in seeds:
        check_number("seeds", seed, 0, 2**32 - 1)
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError(f"--seeds {seeds}: give different numbers, at least one")


def seeded(variant: str, seed: int) -> tuple[str, ...]:
    """Options of an input variant, and of the seed of initial weights and training windows."""
    return f"--data.variant={variant}", f"--seed_everything={seed}", f"--data.seed={seed}"


def _judged(fit: list[str], config: Mapping[str, Any]) -> list[str]:
    """What decides the windows that are judged, of a complete configuration, and the trainer's options of `fit`."""
    windows = {f"data.{name}": config["data"][name] for name in FIXED if name not in ("store", "variant")}
    return split_arguments(fit, ("trainer",))[1] + as_options(windows)
