"""The loop that brings a study to its end, in one process: failures, losses, the last place, comparability."""

from collections.abc import Callable
from pathlib import Path

import optuna
import pytest
from optuna.storages import BaseStorage
from optuna.trial import TrialState

from envpred.errors import UserError
from sweeps.runs.processes import identity
from sweeps.runs.trial import TrialEndedError, TrialFailedError
from sweeps.study.retry import MAX_LOSSES, REASON, RETRY_OF, WORKER, Pulse, Watch
from sweeps.study.sampling import pruner, sampler
from sweeps.study.storage import open_storage
from sweeps.study.worker import ARGUMENTS, IDENTITY, OUT_OF_MEMORY, Worker, check_identity, failed_with, open_study
from tests.remedies import remedy

SAME = {"space": "a", "data": "b"}
Rung = Callable[[int, float], None]
Poll = Callable[[], None]


def opened(folder: Path, seed: int = 0, pruned: bool = False) -> tuple[optuna.Study, BaseStorage]:
    storage = open_storage(folder, None)
    return open_study(storage, "s", SAME, sampler("tpe", seed), pruner("median" if pruned else "none")), storage


def square(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
    on_poll()
    return trial.suggest_float("x", -1, 1) ** 2


def states(study: optuna.Study) -> list[str]:
    return [trial.state.name for trial in study.get_trials(deepcopy=False)]


def test_a_study_ends_with_the_trials_asked_for_and_goes_on_to_more(tmp_path: Path) -> None:
    Worker(*opened(tmp_path), 3, square).work()
    study, storage = opened(tmp_path)
    Worker(study, storage, 3, square).work()
    assert states(study) == ["COMPLETE"] * 3
    Worker(study, storage, 5, square).work()
    assert states(study) == ["COMPLETE"] * 5


def test_an_interrupted_study_draws_what_an_uninterrupted_one_draws(tmp_path: Path) -> None:
    whole, storage = opened(tmp_path / "whole")
    Worker(whole, storage, 14, square).work()
    for trials in (5, 14):
        parts, storage = opened(tmp_path / "parts")
        Worker(parts, storage, trials, square).work()
    assert [t.params for t in parts.trials] == [t.params for t in whole.trials]
    assert len({t.params["x"] for t in whole.trials}) == 14
    other, storage = opened(tmp_path / "other", seed=1)
    Worker(other, storage, 2, square).work()
    assert other.trials[0].params != whole.trials[0].params


def test_failures_are_kept_with_their_reason_and_made_up_for(tmp_path: Path) -> None:
    def objective(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        if trial.number in (1, 2):
            raise TrialFailedError("val/mse is nan")
        return square(trial, on_rung, on_poll)

    study, storage = opened(tmp_path)
    Worker(study, storage, 3, objective).work()
    assert states(study) == ["COMPLETE", "FAIL", "FAIL", "COMPLETE", "COMPLETE"]
    assert study.trials[1].user_attrs[REASON] == "val/mse is nan"


def test_a_trial_that_a_signal_has_ended_is_run_again(tmp_path: Path) -> None:
    """It counts neither as failed nor as lost for ever; nor is it run again and again."""

    def objective(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        value = square(trial, on_rung, on_poll)
        if trial.number in ended:
            raise TrialEndedError("ended from outside by SIGTERM")
        return value

    ended = {1, 2}
    study, storage = opened(tmp_path / "a")
    Worker(study, storage, 2, objective, max_failures=1).work()
    assert states(study) == ["COMPLETE", "FAIL", "FAIL", "COMPLETE"]
    assert [trial.user_attrs.get(RETRY_OF) for trial in study.trials] == [None, None, 1, 2]
    assert len({trial.params["x"] for trial in study.trials[1:]}) == 1
    ended = set(range(MAX_LOSSES + 1))
    study, storage = opened(tmp_path / "b")
    Worker(study, storage, 1, objective).work()
    assert [trial.user_attrs.get(RETRY_OF) for trial in study.trials] == [None, *range(MAX_LOSSES), None]


def test_failure_after_failure_ends_the_study(tmp_path: Path) -> None:
    def objective(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        if trial.number in (0, 6, 7):
            return 1.0
        raise TrialFailedError("no drive to train")

    study, storage = opened(tmp_path)
    with pytest.raises(UserError, match=r"the last 4 trials .* failed; the last one, 4: no drive to train") as failure:
        Worker(study, storage, 3, objective, max_failures=4).work()
    assert states(study) == ["COMPLETE", *["FAIL"] * 4]
    ((option,),) = remedy(failure.value)
    Worker(study, storage, 3, objective, **{option.removeprefix("--"): 7}).work()  # type: ignore[arg-type]
    assert states(study)[4:] == ["FAIL", "FAIL", "COMPLETE", "COMPLETE"]


def test_what_ran_out_of_memory_is_found_again(tmp_path: Path) -> None:
    def objective(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        trial.set_user_attr(ARGUMENTS, {"model.channels": [4]} if trial.number < 2 else {"model.channels": [8]})
        if trial.number < 2:
            raise TrialFailedError("CUDA out of memory" if trial.number else "another", bool(trial.number))
        return 1.0

    study, storage = opened(tmp_path)
    Worker(study, storage, 1, objective).work()
    found = failed_with(study, {"model.channels": [4]})
    assert found is not None
    assert (found.number, found.user_attrs[OUT_OF_MEMORY]) == (1, True)
    assert failed_with(study, {"model.channels": [8]}) is None


def test_bad_trials_are_pruned_and_do_not_count(tmp_path: Path) -> None:
    def objective(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        value = 1.0 if trial.number == 6 else 0.1
        for rung in range(1, 11):
            on_rung(rung, value)
        return value

    study, storage = opened(tmp_path, pruned=True)
    Worker(study, storage, 8, objective).work()
    assert states(study) == ["COMPLETE"] * 6 + ["PRUNED"] + ["COMPLETE"] * 2
    assert study.trials[6].user_attrs[REASON] == "pruned at 50 % of its schedule"


def test_a_retry_is_run_with_the_same_values_and_once(tmp_path: Path) -> None:
    """Two others notice at once that the worker of trial 0 is gone."""
    study, _ = opened(tmp_path)
    trial = study.ask()
    x = trial.suggest_float("x", -1, 1)
    trial.set_user_attr(WORKER, identity() | {"started": 1})  # our process number, but an earlier process
    said: list[str] = []
    for _ in range(2):
        other, storage = opened(tmp_path)
        Watch(other, 60, said.append).look()
    assert said == ["trial 0: its worker is gone; its values are run again"]
    assert states(study) == ["FAIL", "WAITING"]
    Worker(other, storage, 3, square).work()
    assert states(study) == ["FAIL", "COMPLETE", "COMPLETE", "COMPLETE"]
    assert study.trials[1].params == {"x": x}
    assert study.trials[1].user_attrs[RETRY_OF] == 0


def test_a_trial_that_takes_its_workers_along_is_given_up(tmp_path: Path) -> None:
    study, _ = opened(tmp_path)
    said: list[str] = []
    for _ in range(MAX_LOSSES + 1):
        study.ask().set_user_attr(WORKER, identity() | {"started": 1})
        Watch(study, 60, said.append).look()
    assert states(study) == ["FAIL"] * (MAX_LOSSES + 1)
    assert said[-1].endswith("it is not run again")


def test_a_worker_elsewhere_is_known_by_its_pulse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    study, _ = opened(tmp_path)
    trial = study.ask()
    pulse = Pulse(trial, 60)
    trial.set_user_attr(WORKER, identity() | {"machine": "another", "started": 1})
    watch = Watch(study, 60, lambda line: None)
    for _ in range(20):  # it is heard
        clock[0] += 11
        pulse.beat()
        watch.look()
    assert states(study) == ["RUNNING"]
    clock[0] += 59  # silent, but not for long
    watch.look()
    assert states(study) == ["RUNNING"]
    clock[0] += 2
    watch.look()
    assert states(study) == ["FAIL", "WAITING"]
    clock[0] += 11
    with pytest.raises(optuna.exceptions.UpdateFinishedTrialError):
        pulse.beat()  # it comes back too late, and learns it


def test_a_worker_killed_before_its_first_pulse_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    study, _ = opened(tmp_path)
    study.ask()
    watch = Watch(study, 60, lambda line: None)
    watch.look()
    clock[0] += 61
    watch.look()
    assert states(study) == ["FAIL", "WAITING"]


def test_the_last_place_is_taken_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another worker starts a trial between our count and our start: ours waits, and is run when the other fails."""
    study, storage = opened(tmp_path)
    worker = Worker(study, storage, 1, square)
    others: list[optuna.Trial] = []
    ask = study.ask

    def late() -> optuna.Trial:
        if not others:
            others.append(ask())
        return ask()

    monkeypatch.setattr(study, "ask", late)
    assert worker._next() is None
    assert states(study) == ["RUNNING", "WAITING"]
    assert worker._next() is None  # one runs, one is asked for
    study.tell(others[0], state=TrialState.FAIL)
    worker.work()
    assert states(study) == ["FAIL", "COMPLETE"]


def test_an_interrupted_trial_is_run_again(tmp_path: Path) -> None:
    def interrupted(trial: optuna.Trial, on_rung: Rung, on_poll: Poll) -> float:
        square(trial, on_rung, on_poll)
        raise KeyboardInterrupt

    study, storage = opened(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        Worker(study, storage, 1, interrupted).work()
    Worker(study, storage, 1, square).work()
    assert states(study) == ["FAIL", "COMPLETE"]
    assert study.trials[0].params == study.trials[1].params


def test_a_study_without_one_error_a_trial_is_refused(tmp_path: Path) -> None:
    study, storage = opened(tmp_path)
    study.set_user_attr(IDENTITY, ["no", "identity"])
    with pytest.raises(UserError, match=r"the study s is damaged; .*under another name"):
        open_study(storage, "s", SAME, sampler("random", 0), pruner("none"))


def test_a_study_of_something_else_is_refused_unless_asked(tmp_path: Path) -> None:
    study, storage = opened(tmp_path)
    names = (sampler("random", 0), pruner("none"))
    with pytest.raises(UserError, match=r"another data \(b there, c here\); .* --force"):
        open_study(storage, "s", SAME | {"data": "c"}, *names)
    open_study(storage, "s", SAME | {"data": "c"}, *names, force=True)
    with pytest.raises(UserError, match="another data"):
        check_identity(study, SAME)
