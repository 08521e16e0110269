"""How a report's numbers came about, as a paragraph for a paper: written from the results alone."""

from collections.abc import Sequence
from pathlib import Path

from envpred.horizons import in_seconds
from envpred.report.contrasts import EPOCHS
from envpred.report.run import Run
from envpred.report.seeds import groups
from envpred.report.statistics import LEAST_DRIVES, LEVEL, Comparison
from envpred.report.table import latex_text
from envpred.report.tables import measured_on
from envpred.results.names import LEARNED
from envpred.store.files import replace_text

NAMED = 6  # drives that a paragraph names
LETTERS = 12  # of a revision


def paragraph(runs: Sequence[Run], compared: Sequence[Comparison]) -> str:
    """Data, training, seeds, measure, statistics and revision of the `runs`, single seeds each, in plain English."""
    parts = [_data(runs[0]), *_training(runs), *_rest(runs)]
    parts.append(
        "The error is the squared error of the probability of occupied, mean over the cells of a grid, then over "
        "windows."
    )
    return " ".join([*parts, _statistics(runs[0], compared), _revision(runs)])


def write_paragraph(text: str, out: Path) -> None:
    """Write a paragraph into the folder `out`, as text and for LaTeX."""
    replace_text(out / "methods_paragraph.txt", f"{text}\n")
    replace_text(out / "methods_paragraph.tex", f"{latex_text(text)}\n")


def _data(run: Run) -> str:
    data, first, last = run.data, run.horizon_s[0], run.horizon_s[-1]
    cells = f"{data['cells']} × {data['cells']} cells of" if "cells" in data else "cells of"
    return (
        f"All methods forecast the same {measured_on(run)} ({_listed(list(dict.fromkeys(run.drives)))}; split: "
        f"{data['split']}), {data['window_rule']}: {data['given']} frames are shown and {len(run.horizon_s)} forecast, "
        f"{in_seconds(first)} to {in_seconds(last)} ahead, as grids of {cells} {data['resolution']:.3g} m."
    )


def _training(runs: Sequence[Run]) -> list[str]:
    """What was trained on what, methods that share their training in one sentence."""
    found: dict[str, list[str]] = {}
    for group in groups([run for run in runs if run.role == LEARNED]):
        run = group[0]
        trained = run.record["model"].get("trained")
        if trained is None:
            continue
        drives = trained.get("data", {}).get("drives", [])
        seeds = [str(member.record.get("seed")) for member in group]
        where = f" on {len(drives)} drive{'s' * (len(drives) != 1)} ({_listed(drives)})" if drives else ""
        settings = run.record["model"]["hyperparameters"]
        stages = [settings[key] for key in EPOCHS if settings.get(key)]
        epochs = f" for {' and then '.join(map(str, stages))} epochs" if stages else ""
        averaged = ", whose errors are averaged window by window" if len(seeds) > 1 else ""
        how = f"trained{where}{epochs}, seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}{averaged}"
        found.setdefault(how, []).append(f"{run.method} ({run.record['model']['parameters']:,} parameters)")
    return [f"{'; '.join(names)}: {how}." for how, names in found.items()]


def _rest(runs: Sequence[Run]) -> list[str]:
    """What was not trained, and what reads the future."""

    def named(chosen: Sequence[Run]) -> str:
        return "; ".join(dict.fromkeys(run.label for run in chosen))

    untrained = [run for run in runs if run.role == LEARNED and run.record["model"].get("trained") is None]
    fixed = [run for run in runs if run.role not in (LEARNED, "oracle")]
    oracles = [run for run in runs if run.is_oracle]
    return [
        *([f"Of random or unknown weights: {named(untrained)}."] if untrained else []),
        *([f"Without training: {named(fixed)}."] if fixed else []),
        *([f"Bounds that read the future, and no forecasts: {named(oracles)}."] if oracles else []),
    ]


def _statistics(run: Run, compared: Sequence[Comparison]) -> str:
    drives = len(set(run.drives))
    errors = "Standard errors take the drive as the unit of chance (of a mean over clusters; Liang and Zeger 1986)."
    if drives < LEAST_DRIVES:
        return f"{errors} With fewer than {LEAST_DRIVES} drives (here {drives}) no difference was tested."
    questions = len({c.contrast for c in compared})
    return (
        f"{errors} {questions} differences that were planned beforehand were tested at "
        f"{len(compared) // max(questions, 1)} horizons each by turning round the signs of whole drives, two-sided, "
        f"corrected together by the largest statistic (Westfall and Young 1993), at a level of {LEVEL:.0%}; intervals "
        "are of 95 % (Student's t over drives)."
    )


def _revision(runs: Sequence[Run]) -> str:
    told = list(dict.fromkeys(str(run.record["revision"]) for run in runs if run.record.get("revision")))
    if not told:
        return "The results do not tell their revision."
    shown = [one[:LETTERS] + " with uncommitted changes" * one.endswith("-dirty") for one in told]
    return f"Measured with envpred, revision{'s' * (len(told) > 1)} {', '.join(shown)}."


def _listed(names: Sequence[str]) -> str:
    """Names, or the first of them and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(map(str, names[:NAMED])) + more
