"""What a forecaster sees ends with the last frame shown; what it declares is turned and cut as a whole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from envpred.datamodules import GridDataModule, Needs
from envpred.datamodules.selection import select
from envpred.datamodules.symmetry import COUNT, turn_covariance, turn_vector
from envpred.datamodules.variants import variant
from envpred.datamodules.windows import Draw, WindowDataset, collate, every_window
from envpred.store import Store
from tests.store.stores import write_store

GIVEN, HORIZONS, CONTEXT = 3, 5, 32


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with velocities and a wide grid."""
    return write_store(tmp_path_factory.mktemp("grids") / "grids", {"a": list(range(20))}, dogma=True, context=CONTEXT)


def dataset(
    store: Path, needs: Needs | None = None, name: str = "dst_static", crop: int | None = None
) -> WindowDataset:
    places = every_window(select(["a"], Store(store).drives), GIVEN + HORIZONS)
    return WindowDataset(places, variant(name), GIVEN, HORIZONS, needs, crop)


def tensors(fields: Any) -> dict[str, Tensor]:
    """All tensors in nested dictionaries, by their path."""
    found: dict[str, Tensor] = {}
    for name, value in fields.items():
        found |= {f"{name}.{k}": v for k, v in tensors(value).items()} if isinstance(value, dict) else {name: value}
    return found


def test_what_is_seen_ends_with_the_last_frame_shown(store: Path) -> None:
    """Also for one who looks behind the tensors: their memory holds nothing else."""
    needs = Needs(arrays=("velocity", "particle_forecast"), context=True)
    batch = collate([dataset(store, needs)[2]])
    for name, tensor in tensors(batch["seen"]).items():
        if name not in ("sensor", "body", "resolution", "period"):
            assert tensor.shape[:2] == (1, GIVEN), name
        assert tensor.untyped_storage().nbytes() == tensor.numel() * tensor.element_size(), name
    assert not any(name.startswith("future") for name in batch["seen"])


def test_only_what_is_declared_is_read(store: Path) -> None:
    plain = dataset(store)[0]["seen"]
    assert plain["arrays"] == {}
    assert "context" not in plain
    told = dataset(store, Needs(future_pose=True))[0]
    torch.testing.assert_close(told["seen"]["future_pose"], told["future"]["pose"])  # type: ignore[index]
    torch.testing.assert_close(told["seen"]["future_centre_cell"], told["future"]["centre_cell"])  # type: ignore[index]


def test_the_wide_grid_lies_around_the_judged_one(store: Path) -> None:
    seen = dataset(store, Needs(context=True))[0]["seen"]
    drive, margin = Store(store).drives["a"], (CONTEXT - 16) // 2
    np.testing.assert_array_equal(seen["context_label"], drive.array("context_label")[:GIVEN])
    np.testing.assert_array_equal(seen["context"], drive.array("context_evidence")[:GIVEN].astype(np.float32))
    inside = slice(margin, margin + 16)
    np.testing.assert_array_equal(seen["context_label"][:, inside, inside], seen["label"])


def test_velocities_beyond_the_judged_grid_are_not_known(store: Path) -> None:
    seen, margin = dataset(store, Needs(context=True), "dst_dogma")[0]["seen"], (CONTEXT - 16) // 2
    inside = slice(margin, margin + 16)
    torch.testing.assert_close(seen["context"][:, 2:, inside, inside], seen["frames"][:, 2:])
    assert seen["context"][:, 2:].abs().sum() == seen["frames"][:, 2:].abs().sum() > 0


@pytest.mark.parametrize("symmetry", range(COUNT))
def test_everything_turns_together(store: Path, symmetry: int) -> None:
    """The cell that holds the mover, its velocity as a channel and as a stored array, and the place of the sensor."""
    needs = Needs(arrays=("velocity", "velocity_cov"), context=True)
    data = dataset(store, needs, "dst_dogma")
    plain, turned = data[1]["seen"], data[Draw(1, symmetry)]["seen"]
    expected = turn_vector(np.array([1.0, 0.0]), symmetry)  # the mover drives east
    velocity, channels = turned["arrays"]["velocity"].numpy().astype(float), turned["frames"][:, 2:].numpy()
    for field in (velocity, channels, turned["context"][:, 2:].numpy()):
        fastest = field[-1].reshape(2, -1)[:, np.hypot(*field[-1]).argmax()]
        np.testing.assert_allclose(fastest / np.hypot(*fastest), expected, atol=1e-6)
    moving = np.hypot(*velocity[-1]) > 0
    np.testing.assert_array_equal(np.hypot(*channels[-1]) > 0, moving)
    assert (turned["frames"][-1, 0].numpy()[moving] > 0.6).all()
    margin = (CONTEXT - 16) // 2
    assert (turned["context"][-1, 0, margin:-margin, margin:-margin].numpy()[moving] > 0.6).all()
    mirrored = bin(symmetry).count("1") % 2 == 1
    torch.testing.assert_close(
        turned["sensor"], plain["sensor"] * torch.tensor([1.0, *([-1.0] * 2 if mirrored else [1.0] * 2)])
    )


@pytest.mark.parametrize("symmetry", range(COUNT))
def test_covariances_turn_as_what_they_are_of(symmetry: int) -> None:
    vectors = np.random.default_rng(0).normal(size=(50, 2)) @ np.array([[2.0, 0.3], [0.0, 0.5]])
    turned = turn_vector(vectors, symmetry)

    def moments(of: np.ndarray) -> np.ndarray:
        return np.array([np.mean(of[:, 0] ** 2), np.mean(of[:, 0] * of[:, 1]), np.mean(of[:, 1] ** 2)])

    np.testing.assert_allclose(turn_covariance(moments(vectors), symmetry), moments(turned))


def test_a_crop_cuts_all_of_a_window(store: Path) -> None:
    """Stored arrays and the wide grid too, which keeps its margin around the judged one."""
    needs = Needs(arrays=("velocity", "particle_forecast"), context=True)
    corner, crop = (2, 7), 6
    item, full = dataset(store, needs, crop=crop)[Draw(3, 5, corner)]["seen"], dataset(store, needs)[Draw(3, 5)]["seen"]
    for name in ("velocity", "particle_forecast"):
        torch.testing.assert_close(item["arrays"][name], full["arrays"][name][..., 2:8, 7:13])
    side = crop + CONTEXT - 16
    torch.testing.assert_close(item["context_label"], full["context_label"][..., 2 : 2 + side, 7 : 7 + side])
    assert item["context"].shape[-2:] == (side, side)


def test_a_stride_takes_every_second_frame(store: Path) -> None:
    data = GridDataModule(store, given=2, length=4, stride=2, test=["a"])
    data.setup("test")
    first, second = data.datasets["test"][0], data.datasets["test"][1]
    drive = Store(store).drives["a"]
    np.testing.assert_array_equal(first["seen"]["label"], drive.array("label")[[0, 2]])
    np.testing.assert_array_equal(first["future"]["label"], drive.array("label")[[4, 6]])  # type: ignore[index]
    assert second["start"] == 8
    np.testing.assert_allclose(first["seen"]["time"], [-0.2, 0.0], atol=1e-6)
    assert (data.period, data.horizons) == (0.2, 2)


def test_windows_reach_a_second_and_a_half_by_default(store: Path) -> None:
    for stride, horizons in ((1, 15), (2, 8)):
        data = GridDataModule(store, given=2, stride=stride, test=["a"])
        data.selected = {"test": select(["a"], Store(store).drives)}
        assert data.horizons == horizons
