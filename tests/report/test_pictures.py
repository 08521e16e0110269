"""What a test run draws, on the page of a report."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from envpred.callbacks.pictures import Pictures
from envpred.errors import UserError
from envpred.models import LastFrame, MovedLastFrameOracle
from envpred.report import report
from envpred.report.pictures import compared_scenes
from envpred.report.runs import read_runs
from tests.models.trainers import grids, trainer
from tests.report.conftest import draw_windows
from tests.store.stores import write_store

MakeRun = Callable[..., Path]


def test_velocities_of_a_test_run_reach_the_report(tmp_path: Path) -> None:
    store = write_store(tmp_path / "grids", {"a": list(range(16))}, dogma=True)
    data = grids(store, test=["a"], variant="prob_dogma")
    run = trainer(tmp_path / "run", callbacks=[Pictures()])
    run.test(LastFrame("prob_dogma", 3), datamodule=data, verbose=False)
    page = report([tmp_path / "run"], tmp_path / "out").read_text()
    captions = re.findall(r"<figcaption>Static: (.*?)</figcaption>", page)
    assert captions == [f"window {n} {kind}" for n in (0, 1) for kind in ("errors", "velocity")]
    scene, _ = compared_scenes(read_runs([tmp_path / "run"]))
    assert (scene.resolution, scene.period) == pytest.approx((1 / 3, 0.1))


def test_oracles_are_known_in_the_windows_that_are_compared(make_run: MakeRun) -> None:
    runs = [make_run(), make_run(MovedLastFrameOracle, "dst_static", level=0.01)]
    for folder in runs:
        draw_windows(folder)
    for scene in compared_scenes(read_runs(runs)):
        assert list(scene.forecasts) == ["PredNet, DST static", "Last frame, true motion", "Static"]
        assert scene.oracles == {"Last frame, true motion"}


@pytest.mark.parametrize("told", [{"pictures": {"window_0": "../private.png"}}, {"drawn": "../../drawn.npz"}])
def test_nothing_outside_a_run_comes_into_its_report(make_run: MakeRun, tmp_path: Path, told: dict[str, Any]) -> None:
    run = make_run(change=lambda record: record.update(told))
    Image.new("L", (9, 9)).save(run.parent / "private.png")
    draw_windows(other := make_run())
    (other / "drawn.npz").rename(tmp_path / "drawn.npz")
    with pytest.raises(UserError, match=r"result\.json: names '\.\./.*make it again"):
        report([run], tmp_path / "out")
    assert not (tmp_path / "out" / "report.html").exists()
