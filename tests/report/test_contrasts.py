"""Which comparisons are planned."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from envpred.models import (
    FCNForecaster,
    LastFrame,
    MovedLastFrame,
    MovedLastFrameOracle,
    PredNetForecaster,
    RolloutForecaster,
)
from envpred.report.contrasts import (
    AGAINST_MOVED,
    AGAINST_ROLLOUT,
    AGAINST_STATIC,
    EVIDENCE,
    STAGES,
    VELOCITIES,
    planned,
)
from envpred.report.runs import read_runs

MakeRun = Callable[..., Path]


def hyperparameters(**values: object) -> Callable[[dict[str, Any]], None]:
    return lambda record: record["model"].update(hyperparameters=values)


def test_contrasts_are_the_questions_asked_beforehand(make_run: MakeRun) -> None:
    both = hyperparameters(t1_epochs=2, t5_epochs=3, channels=[16])
    folders = [
        make_run(PredNetForecaster, variant, change=both)
        for variant in ("dst_static", "dst_dogma", "prob_static", "prob_dogma")
    ]
    folders.append(make_run(change=hyperparameters(t1_epochs=0, t5_epochs=3, channels=[16])))
    folders.append(make_run(change=hyperparameters(t1_epochs=0, t5_epochs=3, channels=[32])))  # two things differ
    folders.append(make_run(FCNForecaster, "prob_dogma"))
    folders.append(make_run(MovedLastFrame, "prob_static"))
    folders.append(make_run(RolloutForecaster, "dst_static", 0.03))
    folders.append(make_run(LastFrame, "dst_static", 0.09))
    folders.append(make_run(MovedLastFrameOracle, "dst_static", 0.01))
    runs = read_runs(folders)
    two, _, _, _, one, other, *_ = (run.label for run in runs)
    found = planned(runs)
    assert len(found) == len(set(found))

    def asked(question: str) -> list[tuple[str, str]]:
        return [(c.first, c.second) for c in found if c.question == question]

    learned = [run.label for run in runs if run.role == "learned"]
    moved, rollout = "Moved last frame", "Rollout"
    assert asked(AGAINST_STATIC) == [(label, "Static") for label in (*learned, moved, rollout)]
    assert asked(AGAINST_MOVED) == [(label, moved) for label in (*learned, rollout)]
    assert asked(AGAINST_ROLLOUT) == [(label, rollout) for label in learned]
    assert asked(EVIDENCE) == [
        (two, "PredNet, probability static"),
        ("PredNet, DST DOGMa", "PredNet, probability DOGMa"),
    ]
    assert asked(VELOCITIES) == [
        (two, "PredNet, DST DOGMa"),
        ("PredNet, probability static", "PredNet, probability DOGMa"),
    ]
    assert asked(STAGES) == [(one, two)]
    assert other not in {c.second for c in found}


def test_one_run_is_compared_with_the_static_baseline_that_it_measured(make_run: MakeRun) -> None:
    (run,) = read_runs([make_run()])
    assert [(c.first, c.second) for c in planned([run])] == [(run.label, "Static")]
