"""A study: what makes trials comparable, and the loop by which any number of workers bring it to its end."""

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

import optuna
from optuna.exceptions import TrialPruned, UpdateFinishedTrialError
from optuna.storages import BaseStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from envpred.errors import UserError
from envpred.interrupts import heed

from ..runs.trial import TrialEndedError, TrialFailedError
from .retry import REASON, RETRY_OF, Pulse, Watch, give_up

IDENTITY = "identity"
ARGUMENTS, OUT_OF_MEMORY = "arguments", "out_of_memory"
WAIT_SECONDS = 1.0

Hooks = tuple[
    Callable[[int, float], None], Callable[[], None]
]  # on_rung and on_poll, see `sweeps.runs.trial.Runner.run`
Objective = Callable[[optuna.Trial, *Hooks], float]


def open_study(
    storage: BaseStorage,
    name: str,
    identity: Mapping[str, str],
    sampler: optuna.samplers.BaseSampler,
    pruner: optuna.pruners.BasePruner,
    force: bool = False,
) -> optuna.Study:
    """Create the study `name`, or join it if its trials are comparable with ours.

    Args:
        storage: where it is kept.
        name: of the study.
        identity: what must be the same for trials to be comparable: what a user calls it -> a value or hash.
        sampler: of the trials that this worker starts.
        pruner: likewise.
        force: go on also if it is not the same.

    Raises:
        UserError: naming what differs.
    """
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        sampler=sampler,
        pruner=pruner,
        direction=StudyDirection.MINIMIZE,
        load_if_exists=True,
    )
    if IDENTITY not in study.user_attrs or force:
        study.set_user_attr(IDENTITY, dict(identity))
    check_identity(study, identity)
    return study


def check_identity(study: optuna.Study, identity: Mapping[str, str]) -> None:
    """Refuse a study whose trials are not comparable with ours.

    Raises:
        UserError: naming what differs.
    """
    theirs = study.user_attrs[IDENTITY]
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    sound = isinstance(theirs, dict) and all(len(trial.values or ()) == 1 for trial in complete)
    if not sound or study.directions != [StudyDirection.MINIMIZE]:
        raise UserError(
            f"the study {study.study_name} is damaged; get it from a backup, or begin anew under another name"
        )
    different = [what for what in identity if theirs.get(what) != identity[what]]
    if different:
        told = ", ".join(f"{what} ({theirs.get(what)} there, {identity[what]} here)" for what in different)
        raise UserError(
            f"the study {study.study_name} was made with another {told}; its trials cannot be compared with these: "
            "give another --name, or --force to go on with it nevertheless"
        )


@dataclass
class Worker:
    """One process that works on a study, one trial at a time.

    Args:
        study: the study.
        storage: its storage.
        trials: complete trials that the study is to hold at its end.
        objective: runs a trial.
        grace: seconds of silence after which another worker counts as dead.
        max_failures: trials that may fail in a row, without one that completes, before it is all given up.
        say: told what happens, a line each.
    """

    study: optuna.Study
    storage: BaseStorage
    trials: int
    objective: Objective
    grace: float = 60.0
    max_failures: int = 5
    say: Callable[[str], None] = print
    watch: Watch = field(init=False)
    durations: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.watch = Watch(self.study, self.grace, self.say)

    def work(self) -> None:
        """Run trials until the study has those asked for, with whoever else works on it.

        Raises:
            UserError: if trials fail and fail.
        """
        while self._count(TrialState.COMPLETE) < self.trials:
            heed()
            self.watch.look()
            self._check_failures()
            trial = self._next()
            if trial is None:
                time.sleep(WAIT_SECONDS * random.uniform(0.5, 1.5))
            else:
                self._run(trial)

    def _next(self) -> optuna.Trial | None:
        """A trial for this worker, or None while those that run may be enough.

        No storage lets one count and start at once, so a worker that started a trial looks again: of several who did so
        for the last place, all but the first see the others, and put theirs back to wait.
        """
        if self._count(TrialState.COMPLETE, TrialState.RUNNING) >= self.trials:
            return None
        trial = self.study.ask()
        if self._count(TrialState.COMPLETE, TrialState.RUNNING) > self.trials:
            self.storage.set_trial_state_values(trial._trial_id, TrialState.WAITING)
            return None
        return trial

    def _run(self, trial: optuna.Trial) -> None:
        pulse, start = Pulse(trial, self.grace), time.monotonic()
        pulse.begin()

        def on_rung(rung: int, value: float) -> None:
            trial.report(value, rung)
            if trial.should_prune():
                raise TrialPruned(f"at {10 * rung} % of its schedule")

        def on_poll() -> None:
            pulse.beat()
            self.watch.look()

        try:
            value = self.objective(trial, on_rung, on_poll)
            self.study.tell(trial, value)
            self.durations.append(time.monotonic() - start)
            self.say(f"trial {trial.number}: {value:.6f} in {_span(self.durations[-1])}; {self._outlook()}")
        except TrialPruned as pruned:
            trial.set_user_attr(REASON, f"pruned {pruned}")
            self.study.tell(trial, state=TrialState.PRUNED)
            self.say(f"trial {trial.number}: pruned {pruned}")
        except TrialEndedError as ended:
            give_up(self.study, self._frozen(trial), str(ended), lost=True, say=self.say)
        except TrialFailedError as failed:
            trial.set_user_attr(REASON, str(failed))
            trial.set_user_attr(OUT_OF_MEMORY, failed.out_of_memory)
            self.study.tell(trial, state=TrialState.FAIL)
            self.say(f"trial {trial.number}: failed, {failed}")
        except UpdateFinishedTrialError:
            self.say(f"trial {trial.number}: was given to another worker, because this one was silent for too long")
        except (KeyboardInterrupt, UserError, OSError):
            give_up(self.study, self._frozen(trial), "interrupted", lost=False, say=self.say)
            raise

    def _count(self, *states: TrialState) -> int:
        return len(self.study.get_trials(deepcopy=False, states=states))

    def _frozen(self, trial: optuna.Trial) -> FrozenTrial:
        return self.study.get_trials(deepcopy=False)[trial.number]

    def _check_failures(self) -> None:
        """Stop when trials fail in a row: it is not their values, then."""
        failed: list[FrozenTrial] = []
        finished = self.study.get_trials(
            deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
        )
        for trial in sorted(finished, key=lambda t: t.datetime_complete.timestamp() if t.datetime_complete else 0):
            if trial.state != TrialState.FAIL:
                failed.clear()
            elif REASON in trial.user_attrs:  # others were lost with their worker
                failed.append(trial)
        if len(failed) >= self.max_failures:
            raise UserError(
                f"the last {len(failed)} trials of the study {self.study.study_name} failed; the last one, "
                f"{failed[-1].number}: {failed[-1].user_attrs[REASON]} (its log lies beside its configuration); "
                "mend it, or give a larger --max_failures"
            )

    def _outlook(self) -> str:
        complete = self._count(TrialState.COMPLETE)
        left = max(self.trials - complete, 0)
        best = self.study.best_trial
        each, workers = sum(self.durations) / len(self.durations), max(1, self._count(TrialState.RUNNING) + 1)
        return f"best {best.value:.6f} (trial {best.number}); {complete} of {self.trials} complete" + (
            f", about {_span(left * each / workers)} left" if left else ""
        )


def failed_with(study: optuna.Study, arguments: Mapping[str, Any]) -> FrozenTrial | None:
    """The trial that ran out of memory with the same arguments, if there is one."""
    for trial in study.get_trials(deepcopy=False, states=(TrialState.FAIL,)):
        if trial.user_attrs.get(OUT_OF_MEMORY) and trial.user_attrs.get(ARGUMENTS) == arguments:
            return trial
    return None


def retried(trial: FrozenTrial) -> int | None:
    """The trial whose values this one runs again."""
    number: int | None = trial.user_attrs.get(RETRY_OF)
    return number


def _span(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
