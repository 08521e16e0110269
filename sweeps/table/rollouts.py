"""The rollout's rows of an ablation: one thing of it changed at a time, and the networks in it and on top."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from envpred.cli.arguments import as_options

ROLLOUT = "rollout"  # the group, its unchanged run, and the store with what it needs
CONFIG, CORRECTED = "rollout", "corrected_rollout"


@dataclass(frozen=True)
class Row:
    """One thing that is changed of the rollout, all else being equal.

    Args:
        question: that it answers, for the reader of the summary.
        changes: arguments that are changed.
        trains: whether a network is trained.
    """

    question: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    trains: bool = False


UNCHANGED = Row("the rollout: 16 ego futures, hit rates, the wide grid, movers; nothing is learned")
ROWS = {
    "rollout_1_future": Row("the ego's likeliest future alone", {"model.futures": 1}),
    "rollout_4_futures": Row("4 ego futures", {"model.futures": 4}),
    "rollout_label_world": Row("rays meet the last label grid instead of hit rates", {"model.world": "label"}),
    "rollout_no_context": Row("the judged grid alone instead of the wide one", {"model.context": False}),
    "rollout_no_movers": Row("a world that stands, without movers", {"model.movers": False}),
    "rollout_corrected": Row("a network trained in it, which corrects the world that rays meet", trains=True),
    "rollout_corrected_forecast": Row(
        "a network trained on top, which corrects the forecast", {"model.corrects": "forecast"}, trains=True
    ),
}


def options(row: Row, judged: list[str], config: Mapping[str, Any]) -> list[str]:
    """The options of `envpred fit` of a row, but for seed and variant.

    Args:
        row: to be run.
        judged: options of the windows that are judged, and of the trainer.
        config: complete configuration of the PredNet beside it, whose steps a network gets.
    """
    given = [f"--config={CORRECTED if row.trains else CONFIG}", *judged, *as_options(row.changes)]
    if not row.trains:
        return given
    model, data = config["model"]["init_args"], config["data"]
    budget = {"model.max_epochs": model["t1_epochs"] + model["t5_epochs"], "data.samples": data["samples"]}
    return [*given, *as_options(budget)]
