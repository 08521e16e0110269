"""The weights that ship: small, whole, told by their cards, and as good as these say."""

import hashlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

import envpred
from envpred.build.grids import mapper_of
from envpred.cli.shipped import names
from envpred.gate.weights import CARD, CONFIG, TENSORS, read_config, shipped
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.evidence import pignistic
from envpred.mapping.mapper import Mapped, Mapper, MappingParameters
from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.models.weights import Weights
from envpred.report.card import card

LARGEST, ALL = 2_000_000, 8_000_000  # bytes
DRIVE, GIVEN, HORIZONS = "2011_09_26_drive_0005_sync", 5, 15
SHIPPED = shipped()


def test_there_are_some_and_all_are_small() -> None:
    sizes = {name: sum(file.stat().st_size for file in folder.iterdir()) for name, folder in SHIPPED.items()}
    assert sizes
    assert max(sizes.values()) < LARGEST
    assert sum(sizes.values()) < ALL


@pytest.mark.parametrize("name", SHIPPED)
def test_file_hash_and_card_agree(name: str) -> None:
    folder, config = SHIPPED[name], read_config(SHIPPED[name])
    assert sorted(file.name for file in folder.iterdir()) == sorted([CARD, CONFIG, TENSORS])
    assert config["name"] == name
    assert hashlib.sha256((folder / TENSORS).read_bytes()).hexdigest() == config["sha256"]
    assert (folder / CARD).read_text() == card(config)
    state = Weights.read(folder).state
    assert sum(tensor.numel() for tensor in state.values()) == config["parameters"]
    forecaster = envpred.load_forecaster(name)
    assert type(forecaster).__name__ == config["forecaster"]
    assert forecaster.trained is not None
    assert forecaster.trained["weights"] == {"name": name, "sha256": config["sha256"]}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_card_tells_of_drives_that_nobody_trained_on(name: str) -> None:
    config = read_config(SHIPPED[name])
    data, rows = config["training"]["data"], config["measured"]
    trained = {drive.partition("@")[0] for drive in data["drives"]}
    assert not [row for row in rows if row["store"] == data["store"] and row["drive"] in trained]
    assert not [drive for drive in trained if drive.startswith("2011_")]  # KITTI's, which are here to test alone
    methods = {row["method"] for row in rows}
    assert methods >= {"static", "moved_last_frame", "rollout", name}
    assert {len([row for row in rows if row["method"] == method]) for method in methods} == {len(rows) // len(methods)}


@cache
def first_window(kitti: Path) -> tuple[Mapper, list[Mapped]]:
    """The first window of a real drive, mapped as the configuration `rollout` says."""
    drive = next(drive for drive in envpred.drives.find_drives(kitti) if drive.name == DRIVE)
    asked = yaml.safe_load(names("grids")["rollout"].read_text())
    velocities = DogmaParameters(ParticleFilterParameters(**asked["particles"]["filter"]))
    mapper = mapper_of(drive, MappingParameters(), asked["context"], velocities)
    return mapper, [mapper.step(drive.scan(k), drive.pose(k), drive.time(k)) for k in drive.frames[: GIVEN + HORIZONS]]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_forecast_of_a_real_drive_is_as_good_as_the_card_says(name: str, kitti: Path) -> None:
    mapper, mapped = first_window(kitti)
    forecaster = envpred.load_forecaster(name)
    forecast = forecaster.forecast(forecaster.see(mapper, mapped[:GIVEN]), HORIZONS).probability[0]
    target = np.stack([pignistic(frame.mass.astype(np.float16).astype(np.float32)) for frame in mapped[GIVEN:]])
    errors = (forecast - torch.from_numpy(target)).square().mean((1, 2))
    config = read_config(SHIPPED[name])
    (row,) = [row for row in config["measured"] if row["drive"] == DRIVE and row["method"] == name]
    measured = [float(errors[round(seconds / 0.1) - 1]) for seconds in config["horizon_s"]]
    assert measured == pytest.approx(row["first"], rel=0.02)
