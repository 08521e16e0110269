"""Imports point one way: a room may import the rooms below it, never one above."""

import ast
from pathlib import Path

import pytest

import envpred

PACKAGE = Path(envpred.__file__).parent

# What each room may import of ours.
ALLOWED = {
    "mapping": {
        "mapping.dogma",
        "mapping.ego_motion",
        "mapping.evidence",
        "mapping.geometry",
        "mapping.hit_rates",
        "mapping.matching",
        "mapping.particles",
        "mapping.particle_state",
        "mapping.particle_forecast",
        "mapping.measurement",
        "mapping.movers",
        "mapping.rays",
        "mapping.rollout",
        "mapping.world",
        "errors",
    },
    "networks": {"networks", "errors"},
    "metrics": {"metrics"},
    "drives": {"drives", "mapping.geometry", "errors"},
    "simulate": {"simulate", "drives", "mapping", "build", "store", "pictures", "errors"},
    "store": {"store", "errors", "__version__"},
    "datamodules": {"datamodules", "store", "mapping", "errors"},
    "horizons": set(),
    "pictures": {
        "pictures",
        "mapping",
        "horizons",
        "results",
        "store",
        "models",
        "datamodules",
    },  # the last two for types
    "results": {"results", "mapping", "store", "models", "horizons", "errors", "__version__"},  # models for types
    "build": {"build", "drives", "interrupts", "mapping", "store", "errors"},
    "models": {
        "models",
        "networks",
        "datamodules",
        "metrics",
        "results",
        "horizons",
        "errors",
        "mapping.ego_motion",
        "mapping.particle_forecast",
    },
}


def imports(file: Path) -> set[str]:
    """What a file imports of ours, without the package's name."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.removeprefix("envpred.") for name in found if name.startswith("envpred.")}


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_rooms_import_only_what_lies_below(room: str) -> None:
    place = PACKAGE / room
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    assert files
    for file in files:
        for name in imports(file):
            assert any(name == a or name.startswith(f"{a}.") for a in ALLOWED[room]), (
                f"{file.name} imports envpred.{name}"
            )


def test_nothing_imports_the_second_name_of_lightning() -> None:
    for file in PACKAGE.rglob("*.py"):
        assert "pytorch_lightning" not in file.read_text()
