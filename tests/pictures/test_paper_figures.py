"""The figures of a scan and of velocities, as a paper takes them."""

from pathlib import Path

import numpy as np

from envpred.pictures.grids import DOUBLE, SINGLE, ground_comparison, save
from envpred.pictures.velocities import of_frame
from envpred.store import Store
from tests.pictures.legible import illegible
from tests.store.stores import write_store


def test_ground_segmentation_is_as_wide_as_two_columns_and_legible(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-30, 30, (90_000, 4)).astype(np.float32)
    fig = ground_comparison(points, {"MRF": points[:, 2] > 0, "RANSAC": points[:, 2] > 1})
    assert fig.get_figwidth() == DOUBLE
    assert illegible(fig) == []
    assert save(fig, tmp_path / "ground.pdf").stat().st_size < 500_000  # points as pixels, letters as letters
    assert b"/FontFile2" in (tmp_path / "ground.pdf").read_bytes()


def test_velocities_are_as_wide_as_one_column_and_legible(tmp_path: Path) -> None:
    store = Store(write_store(tmp_path / "grids", {"a": list(range(4))}, cells=64, dogma=True))
    fig = of_frame(store.drives["a"], 2)
    assert fig.get_figwidth() == SINGLE
    assert illegible(fig) == []
