"""`envpred paper` from the plan to the page."""

import json
import re
import signal
from pathlib import Path

import pytest

from envpred.datamodules.variants import VARIANTS
from envpred.interrupts import end_at_once
from envpred.report.paper import PAGE
from envpred.results.result import RESULT
from sweeps import paper as module
from sweeps.runs.trial import TrialFailedError
from sweeps.table.job import Job
from sweeps.table.published import PRESETS, Preset, published_plan
from tests.remedies import remedy
from tests.store.stores import write_store


def test_plan_is_the_papers_and_judges_the_same_windows() -> None:
    runs = published_plan(PRESETS["demo"], ["--data.val_windows=3", "--data.given=4", "--data.length=19"], {}, [0, 1])
    trained = [run.name for run in runs if run.trains]
    assert trained == [f"prednet_{v}_seed{s}" for v in VARIANTS for s in (0, 1)] + [
        "fcn_prob_dogma_seed0",
        "fcn_prob_dogma_seed1",
    ]
    untrained = [run for run in runs if not run.trains]
    baselines = ["last_frame", "particle_forecast", "moved_last_frame", "moved_particles", "rollout"]
    assert [run.name for run in untrained] == baselines
    for run in untrained:
        assert {"--data.given=4", "--data.length=19"} <= set(run.options)


def test_what_was_tuned_replaces_the_preset() -> None:
    runs = published_plan(PRESETS["small"], [], {"prednet_dst_dogma": "configs/model/prednet.yaml"}, [0])
    configs = {run.name: next(o for o in run.options if o.startswith("--config=")) for run in runs if run.trains}
    assert configs["prednet_dst_dogma_seed0"] == "--config=configs/model/prednet.yaml"
    assert configs["prednet_dst_static_seed0"] == "--config=prednet_small"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["--preset", "small"], "--preset small trains on drives of yours; give their folder as --source"),
        (["--workers", "0"], "--workers 0: give a number of at least 1"),
        (["--trials", "-1"], "--trials -1: give a number of at least 0"),
        (["--seeds", "[1,1]"], r"--seeds \[1, 1\]: give different numbers, at least one"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    given: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        module.main(["--out", str(tmp_path / "out"), *given])
    assert re.search(told, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_a_preset_that_needs_drives_says_what_to_give(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        module.main(["--out", str(tmp_path / "out"), "--preset", "full"])
    source, preset = remedy(capsys.readouterr().err)
    module.main(["--out", str(tmp_path / "out"), *preset, "--dry_run"])
    module.main(["--out", str(tmp_path / "out"), "--preset", "full", *source, str(tmp_path), "--dry_run"])
    assert "are simulated" in capsys.readouterr().out


def put_in_order(*_: object, **__: object) -> None:
    """What is written can be put in order when a signal comes."""
    assert signal.getsignal(signal.SIGTERM) is not end_at_once


def test_what_failed_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(job: Job) -> float:
        raise TrialFailedError("diverged")

    monkeypatch.setattr(Job, "do", fail)
    for made in ("simulate", "grids"):
        monkeypatch.setattr(module, made, put_in_order)
    names = {name: list(range(40)) for name in "abc"}
    write_store(tmp_path / "grids", names, cells=64, dogma=True, context=128)
    with pytest.raises(SystemExit):
        module.main(["--out", str(tmp_path)])
    said = capsys.readouterr().err
    assert "prednet_dst_static_seed0: diverged" in said
    assert "10 of 10 runs failed; run the command again" in said


def test_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module.main(["--out", str(tmp_path / "out"), "--dry_run"])
    said = capsys.readouterr().out
    assert "40 of 45 frames are simulated" in said
    assert "train and test: prednet_prob_dogma_seed0" in said
    assert "test: rollout" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_from_drives_to_the_page_and_not_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "demo", Preset("demo", "demo_fcn", drives=3, frames=24))
    arguments = ["--out", str(tmp_path / "paper"), "--data.samples=2"]
    module.main(arguments)
    out = tmp_path / "paper"
    page = (out / PAGE).read_text()
    assert f"page: {out / PAGE}" in capsys.readouterr().out
    results = sorted(out.glob(f"runs/*/{RESULT}"))
    assert len(results) == 10
    for result in results:
        assert f"runs/{result.parent.name}" in page
    assert {tuple(json.loads(r.read_text())["data"]["drives"]) for r in results} == {
        tuple(json.loads(results[0].read_text())["data"]["drives"])
    }
    stamps = {r: r.stat().st_mtime_ns for r in results}
    module.main(arguments)
    assert {r: r.stat().st_mtime_ns for r in results} == stamps
