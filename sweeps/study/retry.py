"""Trials whose worker is no more: noticed by the others, and run again with the same values.

Optuna's own heartbeat works on databases alone.  Ours needs nothing but a storage: a worker counts up the attribute
`beat` of its running trial.  On the same machine a process can be asked for; of another machine's worker it is the
silence that tells, as long as the *observer's* clock says, so no two clocks are compared.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import FrozenTrial, TrialState, create_trial

from ..runs import processes

WORKER, BEAT, REASON, RETRY_OF, LOSSES = "worker", "beat", "reason", "retry_of", "losses"
MAX_LOSSES = 3  # a trial that takes its worker along so often is to blame itself
BEATS_IN_GRACE = 6


@dataclass
class Pulse:
    """Says that the worker of a running trial is there, as often as needed."""

    trial: optuna.Trial
    grace: float
    beats: int = 0
    last: float = -1e9

    def begin(self) -> None:
        """Name this process as the trial's worker."""
        self.trial.set_user_attr(WORKER, processes.identity())
        self.beat()

    def beat(self) -> None:
        """Count on, if it is time.

        Raises:
            UpdateFinishedTrialError: if others took this worker for dead.
        """
        if time.monotonic() - self.last > self.grace / BEATS_IN_GRACE:
            self.beats += 1
            self.trial.set_user_attr(BEAT, self.beats)
            self.last = time.monotonic()


@dataclass
class Watch:
    """Looks after the running trials of others.

    Args:
        study: the study.
        grace: seconds of silence after which a worker counts as dead.
        say: told about each trial that was lost.
    """

    study: optuna.Study
    grace: float
    say: Callable[[str], None]
    seen: dict[int, tuple[int | None, float]] = field(default_factory=dict)  # trial -> beat, and since when it stands

    def look(self) -> None:
        """Take the trials of dead workers from them, and queue each to be run again, once, by whoever is free."""
        for trial in self.study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            if self._is_lost(trial):
                give_up(self.study, trial, "its worker is gone", lost=True, say=self.say)

    def _is_lost(self, trial: FrozenTrial) -> bool:
        worker, beat = trial.user_attrs.get(WORKER), trial.user_attrs.get(BEAT)
        if worker is not None and processes.is_gone(worker):
            return True
        if trial.number not in self.seen or self.seen[trial.number][0] != beat:
            self.seen[trial.number] = beat, time.monotonic()
        return time.monotonic() - self.seen[trial.number][1] > self.grace


def give_up(
    study: optuna.Study, trial: FrozenTrial, reason: str, lost: bool, say: Callable[[str], None] = lambda line: None
) -> None:
    """Fail a running trial for what its values are not to blame for, and queue them to be run again.

    Whoever fails the trial queues it, and a storage lets one alone do so: it is run again once.
    """
    try:
        study.tell(trial.number, state=TrialState.FAIL)
    except (UpdateFinishedTrialError, ValueError):  # another worker was faster, or the trial is done
        return
    losses = trial.user_attrs.get(LOSSES, 0) + lost
    if losses > MAX_LOSSES:
        say(f"trial {trial.number}: {reason}, for the {losses}th time; it is not run again")
        return
    attributes = {RETRY_OF: trial.number, LOSSES: losses}
    study.add_trial(
        create_trial(
            state=TrialState.WAITING, params=trial.params, distributions=trial.distributions, user_attrs=attributes
        )
    )
    say(f"trial {trial.number}: {reason}; its values are run again")
