"""What says which cells of test windows move: boxes of tracked objects or labels, and what comes of it."""

import json
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.datamodules import GridDataModule
from envpred.datamodules.windows import collate
from envpred.errors import UserError
from envpred.mapping.boxes import MOVES
from envpred.report import report
from envpred.store import Store
from tests.models.trainers import grids
from tests.remedies import remedy
from tests.store.stores import write_store

DRIVES = {name: list(range(24)) for name in "abc"}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two of three drives have boxes."""
    return write_store(tmp_path_factory.mktemp("movers") / "grids", DRIVES, cells=8, moving="bc")


def module_of(store: Path, drives: str, movers: str = "auto") -> GridDataModule:
    module = grids(store, train=["a@-8"], val=["a@8-16"], test=[f"{d}@16-" for d in drives], movers=movers)
    module.setup("test")
    return module


@pytest.mark.parametrize(
    ("drives", "asked", "told"),
    [
        ("bc", "auto", "tracklets"),
        ("ab", "auto", "labels"),  # one for all: a mean over both would be one of neither
        ("bc", "labels", "labels"),
        ("b", "tracklets", "tracklets"),
    ],
)
def test_one_source_for_all_test_drives(store: Path, drives: str, asked: str, told: str) -> None:
    module = module_of(store, drives, asked)
    described = module.describe("test")
    assert described["movers"] == told
    assert ("moving" in described["input_hash"]) == (told == "tracklets")
    window = module.datasets["test"][0]
    assert window["future"] is not None
    assert ("moving" in window["future"]) == (told == "tracklets")
    assert "moving" not in window["seen"]
    module.setup("fit")
    assert module.datasets["val"][0]["future"].keys() == window["future"].keys() - {"moving"}  # type: ignore[union-attr]
    assert module.describe("train")["movers"] is None


def test_the_future_holds_the_stored_frames(store: Path) -> None:
    module = module_of(store, "bc")
    batch = collate([module.datasets["test"][k] for k in range(2)])
    assert batch["future"] is not None
    for b, place in enumerate(module.datasets["test"].places):
        stored = place.drive.array("moving")[place.start + 3 : place.start + 8]
        np.testing.assert_array_equal(batch["future"]["moving"][b], stored)
        assert stored.any()


def test_boxes_that_are_not_there_are_one_line(store: Path) -> None:
    with pytest.raises(UserError, match=r"a: holds no array 'moving'; build it with `envpred grids --store"):
        module_of(store, "ab", "tracklets")


def test_boxes_of_other_rules_are_stale(tmp_path: Path) -> None:
    store = write_store(tmp_path / "grids", DRIVES, cells=8, moving="c")
    Store(store).claim("moving", {"slowest": 1.0}, force=True)
    with pytest.raises(UserError, match="the moving grids of c were built with other parameters"):
        module_of(store, "c")


def test_results_of_both_are_not_compared(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command that the refusal names makes one that can be."""
    monkeypatch.chdir(tmp_path)
    options = [f"--data.store={store}", "--data.test=[c]", "--data.length=8", "--data.given=3", "--pictures.windows=0"]

    def test(*more: str) -> Path:
        before = set(tmp_path.rglob("result.json"))
        main(["test", "--model=LastFrame", *options, *more])
        (made,) = set(tmp_path.rglob("result.json")) - before
        return made.parent

    by_boxes, by_labels = test(), test("--data.movers=labels")
    told = [json.loads((run / "result.json").read_text()) for run in (by_boxes, by_labels)]
    assert [result["data"]["movers"] for result in told] == ["tracklets", "labels"]
    assert told[0]["metrics"]["mse"]["mean"] == told[1]["metrics"]["mse"]["mean"]
    with pytest.raises(UserError, match=r"what labels say, .* what tracklets say, so that") as refusal:
        report([by_boxes, by_labels], tmp_path / "report")
    ((command, *more),) = remedy(refusal.value)
    assert command == "test"
    assert report([by_labels, test(*more)], tmp_path / "report").is_file()
    page = report([by_boxes], tmp_path / "other").read_text()
    assert "by tracklets" in page


@pytest.mark.slow
def test_a_simulated_drive_is_judged_by_its_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the drive to the result, as a user goes."""
    monkeypatch.chdir(tmp_path)
    main(["simulate", "drives", "--drives=1", "--frames=24", "--seed=6", "--workers=1"])
    main(["grids", "--source=drives", "--store=grids", "--workers=1"])
    ((name, drive),) = Store("grids").drives.items()
    main(["test", "--model=LastFrame", "--data.store=grids", f"--data.test=[{name}]", "--data.length=8",
          "--data.given=3", "--pictures.windows=0"])  # fmt: skip
    (file,) = tmp_path.rglob("result.json")
    result = json.loads(file.read_text())
    assert result["data"]["movers"] == "tracklets"
    assert result["data"]["input_hash"].keys() == {"moving"}
    boxes = [np.array(drive.array("moving")[start + 3 : start + 8] == MOVES) for _, start in result["data"]["windows"]]
    told = result["metrics"]["mse_moving_cells"]["per_window"]
    # A window has an error of moving cells where a box moves, and none elsewhere.
    assert [[error is not None for error in window] for window in told] == [b.any(axis=(1, 2)).tolist() for b in boxes]
    assert any(error is not None for window in told for error in window)
