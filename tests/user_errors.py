"""Which messages of `UserError` the tests provoke, and of which they run the remedy.

Every run of pytest adds what it did to a record in pytest's cache; one of all fast, or all slow, tests begins its
record anew.  After `pytest` and `pytest -m slow`, `python -m tests.user_errors` prints what no test did, and fails.
"""

import ast
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from envpred.errors import UserError
from tests.remedies import commands

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("envpred", "sweeps")
RECORDS = Path(".pytest_cache", "d", "user_errors")


@cache
def messages(file: Path) -> dict[range, str]:
    """The lines and the source of every `UserError(...)` in `file`."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "UserError"]
    name = file.relative_to(REPOSITORY).as_posix()
    return {range(call.lineno, (call.end_lineno or call.lineno) + 1): f"{name}: {ast.unparse(call)}" for call in calls}


class Recorder:
    """Adds to the file `record` what happens to a message for the first time, also in processes that tests fork."""

    current: "Recorder"

    def __init__(self, record: Path, patch: pytest.MonkeyPatch) -> None:
        self.record = record
        self.made: dict[str, str] = {}  # its text -> its source
        self.told: set[tuple[str, str]] = set()
        Recorder.current = self

        def make(error: UserError, *args: Any) -> None:
            frame, text = sys._getframe(1), str(args[0])
            file = Path(frame.f_code.co_filename)
            ours = any(file.is_relative_to(REPOSITORY / package) for package in PACKAGES)
            for lines, source in messages(file).items() if ours else ():
                if frame.f_lineno in lines:
                    self.made[text] = source
                    self.tell("provoked", source)
                    # A message that is made of others has their remedies.
                    if commands(text) and not any(m in text and self.made[m] != source for m in self.made):
                        self.tell("names a command", source)
            super(UserError, error).__init__(*args)

        patch.setattr(UserError, "__init__", make)

    def tell(self, what: str, message: str) -> None:
        """Record that `what` happened to a message."""
        if (what, message) not in self.told:
            self.told.add((what, message))
            with self.record.open("a", encoding="utf-8") as out:
                out.write(f"{what}\t{message}\n")


def record_of(config: pytest.Config) -> Path:
    """The file to which a run of pytest adds; a run of all tests of a mark begins it anew."""
    assert config.cache is not None
    record: Path = config.cache.mkdir("user_errors") / config.option.markexpr.replace(" ", "-")
    chosen = config.option.keyword or config.option.deselect or config.option.ignore or config.option.lf
    if config.args_source is pytest.Config.ArgsSource.TESTPATHS and not chosen:
        record.write_text("", encoding="utf-8")
    return record


def main() -> int:
    """Print the messages that no test provoked or whose remedy none ran; 1 if there are any."""
    records = [file.read_text(encoding="utf-8") for file in (REPOSITORY / RECORDS).glob("*")]
    told: dict[str, set[str]] = {what: set() for what in ("provoked", "names a command", "run")}
    for line in "".join(records).splitlines():
        what, _, message = line.partition("\t")
        told[what].add(message)
    files = [file for package in PACKAGES for file in sorted((REPOSITORY / package).rglob("*.py"))]
    made = [message for file in files for message in messages(file).values()]
    unprovoked = [message for message in made if message not in told["provoked"]]
    remedies = [message for message in made if message in told["names a command"]]
    unrun = [message for message in remedies if message not in told["run"]]
    print(*unprovoked, f"{len(unprovoked)} of {len(made)} messages are provoked by no test", sep="\n")
    print(*unrun, f"{len(unrun)} of {len(remedies)} remedies that name a command are run by no test", sep="\n")
    return bool(unprovoked or unrun)


if __name__ == "__main__":
    sys.exit(main())
