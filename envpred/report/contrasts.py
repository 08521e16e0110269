"""The comparisons that a report tests: questions asked before the runs are seen, not every pair of them."""

from collections.abc import Sequence
from typing import Any

from envpred.report.run import Run
from envpred.report.statistics import Contrast
from envpred.results.names import STATIC

AGAINST_STATIC = "better than the static baseline?"
AGAINST_MOVED = "better than the last frame moved with the ego?"
AGAINST_ROLLOUT = "better than the rollout?"
EVIDENCE = "evidence (DST) against probability"
VELOCITIES = "static grids against DOGMas"
STAGES = "one stage of training against two"
EPOCHS = ("t1_epochs", "t5_epochs")  # hyperparameters that say how long each stage is


def planned(runs: Sequence[Run], static: str = STATIC) -> list[Contrast]:
    """The contrasts among `runs`, each method against a reference or against itself with one thing changed.

    Args:
        runs: the methods.
        static: label of the static baseline, if it is no run of its own.
    """
    honest = [run for run in runs if not run.is_oracle]
    still = next((run.label for run in honest if run.role == "static"), static)
    found = [Contrast(run.label, still, AGAINST_STATIC) for run in honest if run.role != "static"]
    for role, question in (("moved", AGAINST_MOVED), ("rollout", AGAINST_ROLLOUT)):
        references = [run.label for run in honest if run.role == role]
        others = [run.label for run in honest if run.role not in ("static", "moved", role)]
        found += [Contrast(label, reference, question) for reference in references[:1] for label in others]
    learned = [run for run in honest if run.role == "learned"]
    for first in learned:
        for second in learned:
            apart = _question(first, second)
            if apart is not None:
                found.append(Contrast(first.label, second.label, apart))
    return found


def _question(first: Run, second: Run) -> str | None:
    """What the two tell apart, if that is one planned thing and nothing else."""
    if first.name != second.name:
        return None
    here, there = _settings(first), _settings(second)
    if first.variant != second.variant:
        if here != there:
            return None
        (source, kind), (other_source, other_kind) = (run.variant.partition("_")[::2] for run in (first, second))
        if (source, other_source) == ("dst", "prob") and kind == other_kind:
            return EVIDENCE
        return VELOCITIES if (kind, other_kind) == ("static", "dogma") and source == other_source else None
    lengths, other_lengths = ([settings.pop(key, None) for key in EPOCHS] for settings in (here, there))
    if here != there or None in lengths or None in other_lengths:
        return None
    return STAGES if 0 in lengths and 0 not in other_lengths else None


def _settings(run: Run) -> dict[str, Any]:
    """Hyperparameters but for the variant, which the run tells itself."""
    return {key: value for key, value in run.record["model"]["hyperparameters"].items() if key != "variant"}
