from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml

from envpred.build.dogma import build_dogma
from envpred.build.grids import build, mapped, mapper_of
from envpred.datamodules import GridDataModule
from envpred.drives import one_drive
from envpred.errors import UserError
from envpred.mapping.dogma import VELOCITY_SCALE, DogmaParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.store import Store
from tests.drives.synthetic import write_drive
from tests.store.stores import write_store

pytestmark = pytest.mark.usefixtures("no_processes")

SMALL = DogmaParameters(ParticleFilterParameters(persistent=2000, births=200))


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return write_store(tmp_path / "grids", {"a": list(range(12)), "b": [*range(6), *range(9, 15)]})


def test_the_configuration_for_ground_velocities_has_the_numbers_of_the_code() -> None:
    file = Path(__file__).parents[2] / "configs" / "grids" / "ground_velocity.yaml"
    given = yaml.safe_load(file.read_text())
    assert given["dogma"] is True
    assert ParticleFilterParameters(**given["particles"]["filter"]) == GROUND


def test_velocities_complete_drives_built_before(store: Path) -> None:
    before = (store / "a" / "evidence.npy").stat()
    build_dogma(store, SMALL, forecasts=["a"], workers=1)
    a, b = (Store(store).drives[name] for name in "ab")
    assert a.array("velocity").shape == (12, 2, 16, 16)
    assert a.array("velocity_cov").shape == (12, 3, 16, 16)
    assert a.array("particle_forecast").shape == (12, 15, 16, 16)
    assert not b.has("particle_forecast")
    after = (store / "a" / "evidence.npy").stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)
    a.verify()
    assert np.abs(np.asarray(a.array("velocity"))).max() > 0


def test_a_second_run_makes_only_what_is_missing(store: Path) -> None:
    build_dogma(store, SMALL, forecasts=["a"], workers=1)
    first = (store / "a" / "manifest.json").stat().st_ino
    build_dogma(store, SMALL, forecasts=["all"], workers=1)
    assert (store / "a" / "manifest.json").stat().st_ino == first
    assert Store(store).drives["b"].has("particle_forecast")


def test_same_parameters_same_bytes_and_a_gap_starts_anew(store: Path, tmp_path: Path) -> None:
    build_dogma(store, SMALL, workers=1)
    other = write_store(tmp_path / "other", {"a": list(range(12)), "b": [*range(6), *range(9, 15)]})
    build_dogma(other, SMALL, workers=1)
    one, two = (np.asarray(Store(folder).drives["b"].array("velocity")) for folder in (store, other))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one[5], one[4])
    np.testing.assert_array_equal(one[6], 0)  # the first frame of a run has no persistent particles yet


@pytest.mark.parametrize("frame", ["ego", "ground"])
def test_the_mapper_makes_the_same_velocities_as_the_job(tmp_path: Path, frame: Literal["ego", "ground"]) -> None:
    source = write_drive(tmp_path / "drives", frames=9, speed=8.0, weave=0.3, missing_scans={5})
    parameters, mapping = replace(SMALL, filter=replace(SMALL.filter, frame=frame)), MappingParameters(GridSpec(64))
    build(source, tmp_path / "grids", mapping, workers=1)
    build_dogma(tmp_path / "grids", parameters, forecasts=["all"], workers=1)
    drive = one_drive(source)
    mapper = mapper_of(drive, mapping, velocities=parameters, with_forecast=True)
    stored = Store(tmp_path / "grids").drives[drive.name]
    for t, frame_ in enumerate(mapped(drive, mapper)):
        made = frame_.velocities
        assert made is not None
        np.testing.assert_array_equal(made.velocity, stored.array("velocity")[t])
        np.testing.assert_array_equal(made.covariance, stored.array("velocity_cov")[t])
        np.testing.assert_array_equal(made.forecast, stored.array("particle_forecast")[t])
    assert np.asarray(stored.array("particle_forecast")).any()


def test_other_parameters_are_refused(store: Path) -> None:
    build_dogma(store, SMALL, workers=1)
    with pytest.raises(UserError, match="other parameters"):
        build_dogma(store, DogmaParameters(ParticleFilterParameters(persistent=3000, births=200)), workers=1)
    with pytest.raises(UserError, match="holds no drive z"):
        build_dogma(store, SMALL, drives=["z"])


def test_drives_of_two_sets_of_particles_are_not_read_together(store: Path) -> None:
    build_dogma(store, SMALL, workers=1)
    fewer = DogmaParameters(ParticleFilterParameters(persistent=1000, births=200))
    build_dogma(store, fewer, drives=["a"], force=True, workers=1)
    told = r"dogma grids of b were .* \(filter.persistent 2000 there, 1000 in the store\); run `envpred grids --store"
    for drives in (["a", "b"], ["b", "a"]):
        with pytest.raises(UserError, match=told):
            GridDataModule(store, "dst_dogma", "custom", drives[:1], drives[1:], length=6, given=2).setup("fit")
    build_dogma(store, fewer, workers=1)
    build_dogma(store, SMALL, drives=["b"], force=True, workers=1)  # and back
    with pytest.raises(UserError, match=r"of a were .* \(filter.persistent 1000 there, 2000 in the store\)"):
        GridDataModule(store, "dst_dogma", test=["a", "b"], length=6, given=2).setup("test")


def test_variants_read_what_was_built(store: Path) -> None:
    build_dogma(store, SMALL, workers=1)
    data = GridDataModule(store, "dst_dogma", length=6, given=2, test=["a"])
    data.setup("test")
    frames = data.datasets["test"][0]["seen"]["frames"]
    assert frames.shape == (2, 4, 16, 16)
    stored = np.asarray(Store(store).drives["a"].array("velocity")[:2], np.float32) / VELOCITY_SCALE
    seen = frames[:, 2:].numpy()
    np.testing.assert_allclose(seen[seen != 0], stored[seen != 0], rtol=1e-6)
