"""Drives of other rates, and every n-th scan of them."""

from pathlib import Path

import numpy as np
import pytest

from envpred.build.dogma import build_dogma
from envpred.build.every import thinned
from envpred.build.grids import build, mapped, mapper_of
from envpred.cli.commands import grids
from envpred.drives import one_drive
from envpred.errors import UserError
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.store import Store
from tests.drives.synthetic import write_drive

pytestmark = pytest.mark.usefixtures("no_processes")

NAME = "2011_09_26_drive_0001_sync"
PARAMETERS = MappingParameters(GridSpec(cells=64))
SMALL = DogmaParameters(ParticleFilterParameters(persistent=500, births=50))


def test_every_second_scan_of_20_hz_is_a_drive_of_10_hz(tmp_path: Path) -> None:
    fast, slow = tmp_path / "fast", tmp_path / "slow"
    write_drive(fast, "0001", frames=15, period=0.05)
    write_drive(slow, "0001", frames=8)
    build(fast, tmp_path / "thinned", MappingParameters(GridSpec(cells=64), every=2))
    build(slow, tmp_path / "grids", PARAMETERS)
    ours, theirs = (Store(tmp_path / name).drives[NAME] for name in ("thinned", "grids"))
    assert ours.frames == list(range(0, 15, 2))
    assert (ours.stretches, ours.period) == ([(0, 8)], 0.1) == (theirs.stretches, theirs.period)
    for array in ("label", "evidence", "centre_cell"):
        np.testing.assert_array_equal(ours.array(array), theirs.array(array))
    np.testing.assert_allclose(ours.array("time"), theirs.array("time"), atol=1e-5)


def test_a_gap_is_one_where_a_scan_is_missing_that_is_asked_for(tmp_path: Path) -> None:
    whole = one_drive(write_drive(tmp_path, "0001", frames=16, missing_scans={3, 8, 9, 10}, period=0.05))
    drive = thinned(whole, 2)
    assert drive.frames == [0, 2, 4, 6, 12, 14]
    assert drive.stretches() == [(0, 4), (4, 2)]
    assert (whole.period, drive.period, thinned(whole, 4).period) == (0.05, 0.1, 0.2)
    assert thinned(whole, 1) is whole
    assert drive.sensor_to_body() == pytest.approx(whole.sensor_to_body())
    np.testing.assert_array_equal(drive.scan(2), whole.scan(2))


def test_another_choice_of_scans_is_another_mapping(tmp_path: Path) -> None:
    write_drive(tmp_path / "drives", "0001", frames=6)
    build(tmp_path / "drives", tmp_path / "grids", PARAMETERS)
    with pytest.raises(UserError, match="every 1 there, 2 asked"):
        build(tmp_path / "drives", tmp_path / "grids", MappingParameters(GridSpec(cells=64), every=2))
    with pytest.raises(UserError, match="--every 0: give 1 for every scan, 2 for every second one"):
        grids(tmp_path / "new", tmp_path / "drives", every=0)


def test_a_drive_of_20_hz_fades_and_is_forecast_by_its_own_period(tmp_path: Path) -> None:
    source = write_drive(tmp_path / "drives", "0001", frames=8, period=0.05)
    drive = one_drive(source)
    mapper = mapper_of(drive, PARAMETERS)
    assert mapper.period == drive.period == 0.05
    masses = [frame.mass for frame in mapped(drive, mapper)]
    build(source, tmp_path / "grids", PARAMETERS)
    stored = Store(tmp_path / "grids").drives[NAME]
    assert stored.period == 0.05
    np.testing.assert_array_equal(stored.array("evidence")[-1], masses[-1].astype(np.float16))
    build_dogma(tmp_path / "grids", SMALL, forecasts=["all"])
    assert Store(tmp_path / "grids").drives[NAME].array("particle_forecast").shape == (8, 30, 64, 64)
