"""The house: arrows of imports point one way, every room is listed, and a file can be read in one sitting."""

import ast
import graphlib
import statistics
from pathlib import Path

import pytest

import envpred

PACKAGE = Path(envpred.__file__).parent
SWEEPS = PACKAGE.parent / "sweeps"

# Every room, from the ground floor up, and what of ours it may import beside itself.
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "gate": {"errors"},
    "caches": set(),
    "interrupts": set(),
    "horizons": {"errors"},
    "compiled": {"__version__"},
    "networks": {"errors"},
    "metrics": {"mapping.geometry", "compiled", "errors"},
    "mapping": {"compiled", "errors"},
    "store": {"mapping.geometry", "interrupts", "gate", "errors", "__version__"},
    "drives": {"mapping.geometry", "mapping.period", "mapping.deskew", "mapping.trajectory", "gate", "errors"},
    "build": {"drives", "mapping", "store", "interrupts", "errors"},
    "datamodules": {"mapping", "store", "horizons", "errors"},
    "models": {
        *("networks", "datamodules", "metrics", "mapping", "store.files", "results.result", "horizons", "gate"),
        "errors",
    },
    "results": {"mapping", "store", "horizons", "gate", "errors", "__version__"},
    "pictures": {"mapping", "store", "results", "horizons", "errors"},
    "simulate": {"compiled", "drives", "mapping", "build", "store", "pictures", "gate", "errors"},
    "live": {
        *("simulate.tracklets", "models", "build", "pictures", "results", "datamodules", "drives", "mapping", "store"),
        *("horizons", "errors", "__version__"),
    },
    "callbacks": {
        *("models", "datamodules", "pictures", "results", "metrics", "mapping", "store", "horizons", "gate", "errors"),
    },
    "report": {"pictures", "results", "metrics", "store.files", "horizons", "gate", "errors"},
    "cli": {
        *(
            "callbacks",
            "report",
            "live",
            "simulate",
            "build",
            "pictures",
            "results",
            "models",
            "datamodules",
            "metrics",
        ),
        *("mapping", "drives", "store", "horizons", "interrupts", "gate", "errors", "__version__"),
    },
    "__init__": {"caches", "drives", "mapping.mapper", "datamodules", "models", "store", "live.stream"},  # the face
    "__main__": {"cli"},
}
# The drawers of sweeps, likewise.
DRAWERS: dict[str, set[str]] = {
    "runs": set(),
    "study": {"runs"},
    "table": {"runs"},
    "tune": {"runs", "study"},
    "ablation": {"runs", "study", "table"},
    "paper": {"runs", "study", "table", "tune"},
}


def imports(file: Path, package: Path) -> set[str]:
    """What a file of `package` imports of it, by its name or relative to the file, without its name; types included."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            start = _ancestor(file, package, node.level) if node.level else []
            found |= {".".join([*start, *([node.module] if node.module else []), alias.name]) for alias in node.names}
    return {name.removeprefix(f"{package.name}.") for name in found if name.startswith(f"{package.name}.")}


def _ancestor(file: Path, package: Path, level: int) -> list[str]:
    """The package, in parts of its name, that a relative import with so many dots starts from."""
    parts = [package.name, *file.relative_to(package).parent.parts]
    assert level <= len(parts), f"{file.name}: a relative import of what lies outside {package.name}"
    return parts[: len(parts) - level + 1]


def files_of(place: Path) -> list[Path]:
    return sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]


def rooms(package: Path) -> set[str]:
    """Folders and modules at the root of a package."""
    names = {f.name for f in package.iterdir() if f.is_dir() and (f / "__init__.py").is_file()}
    return names | {f.stem for f in package.glob("*.py")}


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_rooms_import_only_what_lies_below(room: str) -> None:
    for file in files_of(PACKAGE / room):
        for name in imports(file, PACKAGE):
            allowed = {room, *ALLOWED[room]}
            assert any(name == a or name.startswith(f"{a}.") for a in allowed), f"{file.name} imports envpred.{name}"


@pytest.mark.parametrize("drawer", sorted(DRAWERS))
def test_drawers_of_sweeps_import_only_what_lies_below(drawer: str) -> None:
    for file in files_of(SWEEPS / drawer):
        for name in imports(file, SWEEPS):
            assert name.split(".")[0] in {drawer, *DRAWERS[drawer]}, f"{file.name} imports sweeps.{name}"


def test_every_room_is_listed_and_there_is_no_circle() -> None:
    assert rooms(PACKAGE) == set(ALLOWED)
    assert rooms(SWEEPS) == {*DRAWERS, "__init__"}
    assert len([room for room in rooms(PACKAGE) if not room.startswith("__")]) <= 22
    for floors in (ALLOWED, DRAWERS):
        below = {room: {name.split(".")[0] for name in names} & set(floors) for room, names in floors.items()}
        list(graphlib.TopologicalSorter(below).static_order())  # raises if there is one


def test_files_can_be_read_in_one_sitting() -> None:
    lengths = {file: len(file.read_text().splitlines()) for file in [*PACKAGE.rglob("*.py"), *SWEEPS.rglob("*.py")]}
    assert {file.name: n for file, n in lengths.items() if n > 300} == {}
    assert statistics.median(n for file, n in lengths.items() if file.is_relative_to(PACKAGE)) < 110


def test_every_test_room_mirrors_a_room() -> None:
    tests = {f.name for f in Path(__file__).parent.iterdir() if f.is_dir() and (f / "__init__.py").is_file()}
    assert tests - {"docs", "e2e", "faults", "sweeps"} <= rooms(PACKAGE)
    assert {room for room in rooms(PACKAGE) if (PACKAGE / room).is_dir()} <= tests
    assert {f.name for f in (Path(__file__).parent / "sweeps").iterdir() if (f / "__init__.py").is_file()} <= rooms(
        SWEEPS
    )


def test_nothing_imports_the_second_name_of_lightning() -> None:
    for file in PACKAGE.rglob("*.py"):
        assert "pytorch_lightning" not in file.read_text()
