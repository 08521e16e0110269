"""The weights that ship: small, whole, told by their cards, and as good as these say."""

import hashlib
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load

import envpred
from envpred.build.grids import mapper_of
from envpred.cli.shipped import names
from envpred.cli.weights import with_configuration
from envpred.errors import UserError
from envpred.gate.weights import CARD, CONFIG, TENSORS, read_config, shipped
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.evidence import pignistic
from envpred.mapping.mapper import Mapped, Mapper, MappingParameters
from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.models.weights import Weights, halved, single
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


@pytest.fixture
def edited(tmp_path: Path) -> Callable[..., Path]:
    """Makes a copy of weights, of which `config.json` says something else."""

    def edit(**said: Any) -> Path:
        folder = shutil.copytree(SHIPPED["prednet_dst_static"], tmp_path / "mine", dirs_exist_ok=True)
        config = json.loads((folder / CONFIG).read_text())
        (folder / CONFIG).write_text(json.dumps({**config, **said}))
        return folder

    return edit


def test_a_forecaster_is_given_as_many_frames_as_its_weights_were(edited: Callable[..., Path]) -> None:
    assert envpred.load_forecaster(edited()).given == 5
    folder = edited(given=4)
    assert envpred.load_forecaster(folder).given == 4
    command, config, option = with_configuration(["test", f"--weights={folder}"])
    assert (command, option) == ("test", f"--weights={folder}")
    assert yaml.safe_load(config.removeprefix("--config="))["data"] == {"variant": "dst_static", "given": 4}
    assert with_configuration(["test", "--weights=null"]) == ["test", "--weights=null"]


def test_numbers_at_other_horizons_are_refused(edited: Callable[..., Path]) -> None:
    """Errors of all windows and those of the first, each for itself."""
    row = read_config(SHIPPED["prednet_dst_static"])["measured"][0]
    for name in ("mse", "first"):
        with pytest.raises(UserError, match="measured has other horizons than horizon_s"):
            read_config(edited(measured=[{**row, name: row[name][:-1]}]))


def test_a_folder_runs_nothing_but_our_forecasters(
    edited: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[object] = []
    monkeypatch.setattr(envpred.models, "other", lambda **values: ran.append(values), raising=False)
    with pytest.raises(UserError, match=r"config\.json: other is no forecaster of this version"):
        envpred.load_forecaster(edited(forecaster="other"))
    assert not ran


def test_a_network_too_large_for_any_memory_is_refused_by_its_shape(edited: Callable[..., Path]) -> None:
    huge = {**read_config(SHIPPED["prednet_dst_static"])["init_args"], "channels": [10**7]}
    with pytest.raises(UserError, match="the network of mine's weights are not those of this PredNetForecaster"):
        envpred.load_forecaster(edited(init_args=huge))


def test_a_checkpoint_goes_before_weights_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("prednet_dst_static").write_bytes(b"nothing")
    with pytest.raises(UserError, match="prednet_dst_static: holds more than weights"):
        envpred.load_forecaster("prednet_dst_static")


def test_whole_numbers_among_weights_stay_whole() -> None:
    """2049 and more are none in half precision."""
    state = {"counts": torch.tensor([2049]), "weights": torch.tensor([0.5])}
    read = {name: single(tensor) for name, tensor in load(halved(state)).items()}
    assert read == state
    assert {name: tensor.dtype for name, tensor in read.items()} == {"counts": torch.int64, "weights": torch.float32}


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
