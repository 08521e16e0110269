"""Compiled loops are kept until something that they are made of changes, in whatever file of the package it stands."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from envpred.compiled import PACKAGE

# Marks one point by a constant of another file, and says what it is and whether the loop had been compiled before.
MARK = """
import numpy as np
from envpred.mapping.label_grid import _mark_occupied
grid, wide = np.zeros((4, 4), np.uint8), np.zeros((0, 0), np.uint8)
_mark_occupied(
    grid, wide, 0, 9.0, np.ones((1, 4), np.float32), np.array([True]), np.eye(3)[:2], (0.0, 0.0), (0.0, 0.0, 0.0), 0.0
)
print(grid[1, 1], sum(_mark_occupied.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    shutil.copytree(PACKAGE, tmp_path / "envpred", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "envpred"


def run(package: Path, **environment: str) -> list[str]:
    """What a process of its own marks, with the package in this place, and how often it found the loop compiled."""
    settings = {**os.environ, "PYTHONPATH": str(package.parent), **environment}
    return subprocess.run(
        [sys.executable, "-c", MARK], cwd=package.parent, env=settings, capture_output=True, text=True, check=True
    ).stdout.split()


def change(package: Path) -> None:
    constants = package / "mapping" / "geometry.py"
    before, codes = constants.read_text(), "UNKNOWN, OCCUPIED, FREE, EGO = 0, {}, 2, 3"
    assert codes.format(1) in before
    constants.write_text(before.replace(codes.format(1), codes.format(7)))


def test_a_changed_constant_of_another_file_is_taken(package: Path) -> None:
    assert run(package, NUMBA_CACHE_DIR="") == ["1", "0"]
    assert run(package, NUMBA_CACHE_DIR="") == ["1", "1"]
    change(package)
    assert run(package, NUMBA_CACHE_DIR="") == ["7", "0"]


@pytest.mark.slow
def test_where_the_user_keeps_compiled_loops_too(package: Path) -> None:
    kept = str(package.parent / "kept")
    assert run(package, NUMBA_CACHE_DIR=kept) == ["1", "0"]
    assert run(package, NUMBA_CACHE_DIR=kept) == ["1", "1"]
    change(package)
    assert run(package, NUMBA_CACHE_DIR=kept) == ["7", "0"]
    assert not list(package.rglob("*.nbi"))


@pytest.mark.slow
def test_where_nothing_can_be_kept_each_process_compiles(package: Path) -> None:
    (package / "mapping" / "__pycache__").touch()  # no folder can be made there
    for _ in range(2):
        assert run(package, NUMBA_CACHE_DIR="", HOME="/dev/null", XDG_CACHE_HOME="/dev/null") == ["1", "0"]
