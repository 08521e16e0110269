"""Imports inside `sweeps` point one way: the commands, then studies and tables, then single runs, then envpred."""

import ast
from pathlib import Path

import pytest

import envpred
import sweeps

PACKAGE = Path(sweeps.__file__).parent

# What each room may import of `sweeps`; rooms that stand beside each other know nothing of each other.
ALLOWED = {
    "runs": {"runs"},
    "study": {"study", "runs"},
    "table": {"table", "runs"},
    "tune": {"study", "runs"},
    "ablation": {"table", "study", "runs"},
}


def imported(file: Path) -> set[str]:
    """The modules and names that a file imports of `sweeps`, without the package's name."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}: a relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.removeprefix("sweeps.") for name in found if name.split(".")[0] == "sweeps"}


def test_every_room_is_listed() -> None:
    rooms = {f.parent.name if f.name == "__init__.py" else f.stem for f in PACKAGE.glob("*/__init__.py")}
    assert rooms | {f.stem for f in PACKAGE.glob("*.py") if f.name != "__init__.py"} == set(ALLOWED)


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_rooms_import_only_what_lies_below(room: str) -> None:
    place = PACKAGE / room
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    for file in files:
        for name in imported(file):
            assert name.split(".")[0] in ALLOWED[room], f"{file.relative_to(PACKAGE)} imports sweeps.{name}"


def test_envpred_knows_nothing_of_sweeps() -> None:
    for file in Path(envpred.__file__).parent.rglob("*.py"):
        assert not imported(file), f"{file} imports sweeps"
