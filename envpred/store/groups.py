"""Groups of arrays: what one step makes with one set of parameters, and the command that makes it."""

from pathlib import Path
from shlex import quote
from typing import NamedTuple


class Group(NamedTuple):
    """One group of arrays of a drive.

    Args:
        arrays: names of its arrays.
        job: module of the job that makes them.
        options: of `envpred grids`, beside --store, that make them.
    """

    arrays: tuple[str, ...]
    job: str
    options: str


SOURCE = "--source DRIVES"  # stands for the folder with the drives, which a store does not know
# All groups but the first are made of the first one's grids, and go with them.
GROUPS = {
    "mapping": Group(("label", "evidence", "centre_cell", "pose", "time"), "envpred.build.grids", SOURCE),
    "context": Group(("context_label", "context_evidence"), "envpred.build.grids", f"{SOURCE} --context 256"),
    "dogma": Group(("velocity", "velocity_cov", "particle_forecast"), "envpred.build.dogma", "--dogma"),
    "moving": Group(("moving",), "envpred.build.moving", SOURCE),
}
# What makes an array that its group's command leaves out.
OPTIONS = {"particle_forecast": "--particle_forecast all"}
MAPPING_ARRAYS = GROUPS["mapping"].arrays


def group_of(array: str) -> str | None:
    """The group that the array belongs to, None if this version knows none that makes it."""
    return next((name for name, group in GROUPS.items() if array in group.arrays), None)


def command(store: Path, array: str) -> str:
    """The command that makes `array` for the drives of `store`."""
    options = OPTIONS.get(array) or GROUPS[group_of(array) or "mapping"].options
    return f"envpred grids --store {quote(str(store))} {options}"
