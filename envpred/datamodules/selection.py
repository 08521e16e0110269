"""Which frames of which drives train, validate and test: presets, and lists of drives with an optional range.

A selection is a drive's name, or `name@start-stop` for the frames at positions start to stop - 1 of it; either end may
be left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from envpred.errors import UserError
from envpred.store import Store, StoredDrive
from envpred.store.groups import command

# Drives that the paper's reference code names; it trains on all others.
REFERENCE_VALIDATION = ("2011_09_26_drive_0005_sync", "2011_09_26_drive_0014_sync")
REFERENCE_TEST = ("2011_09_26_drive_0091_sync", "2011_09_26_drive_0015_sync")


@dataclass(frozen=True)
class Selection:
    """Frames `start` to `stop` - 1 (positions, not frame numbers) of a stored drive."""

    drive: StoredDrive
    start: int
    stop: int

    def __str__(self) -> str:
        whole = self.start == 0 and self.stop == len(self.drive.frames)
        return self.drive.name if whole else f"{self.drive.name}@{self.start}-{self.stop}"

    def overlaps(self, other: "Selection") -> bool:
        """Whether both take a frame."""
        return self.drive.name == other.drive.name and self.start < other.stop and other.start < self.stop

    def stretches(self) -> list[tuple[int, int]]:
        """Stretches without a gap inside this one, as (first, length)."""
        inside = []
        for first, length in self.drive.stretches:
            a, b = max(first, self.start), min(first + length, self.stop)
            if a < b:
                inside.append((a, b - a))
        return inside


@dataclass(frozen=True)
class Split:
    """What trains, validates and tests."""

    train: list[Selection]
    val: list[Selection]
    test: list[Selection]


def select(items: list[str], drives: dict[str, StoredDrive]) -> list[Selection]:
    """The stretches that `items` name.

    Raises:
        UserError: if a drive is not in the store, or a range is not inside it.
    """
    chosen = []
    for item in items:
        name, _, bounds = item.partition("@")
        if name not in drives:
            raise UserError(f"the split names drive {name}, which the store does not hold; it has {', '.join(drives)}")
        frames = len(drives[name].frames)
        try:
            first, _, last = bounds.partition("-")
            start, stop = int(first or 0), int(last or frames)
            valid = 0 <= start < stop <= frames
        except ValueError:
            valid = False
        if not valid:
            raise UserError(f"{item}: give drive@start-stop with 0 <= start < stop <= {frames}, its number of frames")
        chosen.append(Selection(drives[name], start, stop))
    return chosen


def warnings_of(selections: Iterable[Selection]) -> dict[str, list[str]]:
    """What was odd about the recordings of `selections`, a line each, by drive; drives without are left out."""
    return {chosen.drive.name: chosen.drive.warnings for chosen in selections if chosen.drive.warnings}


def told(part: str, windows: int, selections: Sequence[Selection]) -> str:
    """How many `windows` a `part` has of which drives (of more than eight the first and the last), in a line.

    What was odd about the recordings follows, a line each.
    """
    names = [str(selection) for selection in selections]
    which = ", ".join(names) if len(names) <= 8 else f"{len(names)} drives, {names[0]} to {names[-1]}"
    odd = [f"warning: {line}" for lines in warnings_of(selections).values() for line in lines]
    return "\n".join([f"{part}: {windows} windows of {which}", *odd])


def movers_of(selections: Iterable[Selection], asked: str) -> str:
    """What says which cells of `selections` move: what is asked, or for `auto` tracklets if all drives have them.

    One for all: what they call moving differs, so that a mean over both would be one of neither.
    """
    if asked != "auto":
        return asked
    return "tracklets" if all(selection.drive.has("moving") for selection in selections) else "labels"


def preset(name: str, drives: dict[str, StoredDrive]) -> Split:
    """A split by name.

    `reference`: the two validation and two test drives that the paper's reference code names, all others train; the
    paper itself tested on seven drives, which it does not name.  `auto`: `reference` where the store holds these; else
    the drives in order of their names, the last fifth (at least one) tests, the tenth before it (at least one)
    validates, the others train.  Of two drives the second tests and the last 30 % of the first validate; one drive is
    cut into three fifths, one fifth and one fifth.

    Raises:
        UserError: if the preset is not known, or names a drive that is not in the store.
    """
    names = list(drives)
    if name == "auto":
        if all(drive in drives for drive in (*REFERENCE_VALIDATION, *REFERENCE_TEST)):
            return preset("reference", drives)
        return _auto(names, drives)
    if name == "reference":
        held_out = (*REFERENCE_VALIDATION, *REFERENCE_TEST)
        val, test = select(list(REFERENCE_VALIDATION), drives), select(list(REFERENCE_TEST), drives)
        return Split(select([n for n in names if n not in held_out], drives), val, test)
    raise UserError(
        f"no split {name!r}; give auto or reference, or lists of drives as --data.train, --data.val, --data.test"
    )


def _auto(names: list[str], drives: dict[str, StoredDrive]) -> Split:
    if len(names) == 1:
        (name,) = names
        a, b = (len(drives[name].frames) * fifths // 5 for fifths in (3, 4))
        return Split(*(select([item], drives) for item in (f"{name}@-{a}", f"{name}@{a}-{b}", f"{name}@{b}-")))
    if len(names) == 2:
        first, second = names
        a = len(drives[first].frames) * 7 // 10
        return Split(*(select([item], drives) for item in (f"{first}@-{a}", f"{first}@{a}-", second)))
    test, val = max(1, len(names) // 5), max(1, len(names) // 10)
    return Split(
        select(names[: -test - val], drives), select(names[-test - val : -test], drives), select(names[-test:], drives)
    )


def split_drives(
    name: str, asked: Mapping[str, list[str] | None], drives: dict[str, StoredDrive]
) -> dict[str, list[Selection]]:
    """What trains, validates and tests: the split of that name, but for the parts that are `asked` for as lists.

    What a list names, the split's other parts leave alone.

    Raises:
        UserError: if lists name frames twice, or what is not there.
    """
    lists = {part: select(items, drives) for part, items in asked.items() if items}
    _check_apart(lists)
    base = Split([], [], []) if name == "custom" or len(lists) == len(asked) else preset(name, drives)
    named = [selection for selections in lists.values() for selection in selections]
    rest = {"train": base.train, "val": base.val, "test": base.test}
    rest = {part: [s for s in selections if not any(map(s.overlaps, named))] for part, selections in rest.items()}
    return rest | lists


def _check_apart(parts: Mapping[str, list[Selection]]) -> None:
    """Refuse frames that are taken twice: counted twice, or judged by what has trained on them."""
    taken = [(part, selection) for part, selections in parts.items() for selection in selections]
    for (part, one), (other_part, other) in combinations(taken, 2):
        if one.overlaps(other):
            raise UserError(
                f"--data.{part} takes {one} and --data.{other_part} {other}, which share frames; give other drives, or "
                "stretches that do not overlap, as name@start-stop"
            )


def usable_drives(folder: Path) -> dict[str, StoredDrive]:
    """The finished drives of a store.

    Raises:
        UserError: if there are none, or they differ in their time base or cells.
    """
    store = Store(folder)
    drives = store.drives
    if not drives:
        unfinished = store.unfinished()
        hint = f" ({', '.join(unfinished)} unfinished)" if unfinished else ""
        raise UserError(f"{folder}: holds no finished drive{hint}; run `{command(folder, 'label')}`")
    kinds: dict[str, str] = {}
    for name, drive in drives.items():
        kinds.setdefault(f"{drive.period:.4g} s between frames, cells of {drive.grid.resolution:.4g} m", name)
    if len(kinds) > 1:
        told = "; ".join(f"{name}: {kind}" for kind, name in kinds.items())
        raise UserError(f"{folder}: its drives differ ({told}); keep each kind in a store of its own")
    return drives
