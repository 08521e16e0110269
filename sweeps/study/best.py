"""`best.yaml`: the winning configuration, complete and ready for `envpred fit`, with where it comes from."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import optuna

from envpred.cli.arguments import FitArguments
from envpred.results.result import revision
from envpred.store.files import replace_text

from ..runs.trial import as_yaml
from .worker import ARGUMENTS

BEST = "best.yaml"


def write_best(study: optuna.Study, fit: FitArguments, identity: Mapping[str, str], storage: str, folder: Path) -> Path:
    """Write the best trial's configuration into `folder`, replacing what is there in one step; returns the file.

    Args:
        study: with a complete trial.
        fit: what its trials started from.
        identity: what its trials have in common, see `sweeps.study.worker.open_study`.
        storage: where it is kept, as a user names it, without a password.
        folder: of the study.
    """
    best = study.best_trial
    first = study.get_trials(deepcopy=False)[0]
    about = {
        "study": study.study_name,
        "storage": storage,
        "trial": str(best.number),
        "validation MSE": f"{best.value:.6g}",
        "of the first trial": f"{first.value:.6g}" if first.state == optuna.trial.TrialState.COMPLETE else "none",
        "trials": str(len(study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,)))),
        **identity,
        "revision": revision(),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    arguments = best.user_attrs[ARGUMENTS]
    header = "".join(f"# {what}: {value}\n" for what, value in about.items())
    found = "".join(f"#   {name}: {value}\n" for name, value in arguments.items())
    title = f"# The best configuration that `envpred tune` found; `envpred fit --config {BEST}` trains it again.\n"
    return replace_text(folder / BEST, f"{title}{header}# found:\n{found}{as_yaml(fit.complete(arguments))}")
