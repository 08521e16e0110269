"""`trials.csv`: every trial of a study as a line of a table."""

import csv
import io

import optuna

TRIALS = "trials.csv"


def trials_csv(study: optuna.Study) -> str:
    """All trials: number, state, error, seconds, every argument, and the reason of what is not complete."""
    trials = study.get_trials(deepcopy=False)
    names = list(dict.fromkeys(name for trial in trials for name in trial.params))
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["trial", "state", "val_mse", "seconds", *names, "reason"])
    for trial in trials:
        value = trial.value if trial.state == optuna.trial.TrialState.COMPLETE else ""
        seconds = round(trial.duration.total_seconds(), 1) if trial.duration else ""
        values = [trial.params.get(name, "") for name in names]
        rows.writerow([trial.number, trial.state.name, value, seconds, *values, trial.user_attrs.get("reason", "")])
    return text.getvalue()
