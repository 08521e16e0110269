"""`envpred paper` from the plan to the page."""

import json
import re
import signal
from pathlib import Path

import pytest

from envpred.cli.arguments import FitArguments
from envpred.datamodules.variants import VARIANTS
from envpred.interrupts import end_at_once
from envpred.report.paper import PAGE
from envpred.results.result import RESULT, read_result
from sweeps import paper as module
from sweeps.runs.command import FIXED
from sweeps.runs.trial import TrialFailedError, as_yaml, logged_to
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


def jobs_of(preset: str, folder: Path) -> dict[str, Job]:
    """The runs of a preset, by name, complete as `envpred fit` would read them."""
    runs = published_plan(PRESETS[preset], [], {}, [0])
    return {run.name: Job.of(run, folder / "grids", folder / "runs") for run in runs}


def test_full_has_the_papers_numbers(tmp_path: Path) -> None:
    """Itkina et al. 2019, section IV: PredNet in two stages of 100 epochs of 500 samples, the FCN in 1,975 batches."""
    jobs = jobs_of("full", tmp_path)
    for variant in VARIANTS:
        config = jobs[f"prednet_{variant}_seed0"].config
        model, data = config["model"]["init_args"], config["data"]
        assert config["model"]["class_path"].endswith(".PredNetForecaster")
        assert (model["channels"], model["layer_weights"], model["feedback"]) == ([48, 96, 192], [1.0], "stale")
        for stage in ("t1", "t5"):
            assert (model[f"{stage}_epochs"], model[f"{stage}_drop_epoch"]) == (100, 75)
            assert model[f"{stage}_lr"] == 1e-4
            assert model[f"{stage}_lr"] * model["lr_drop"] == pytest.approx(1e-5)
        assert (model["t5_error"], model["first_scored"]) == ("absolute", 1)
        assert (model["fixed_frame"], model["context"], model["init_from"]) == (False, False, None)
        assert (data["samples"], data["batch_size"], data["val_windows"]) == (500, 1, 100)
        assert (data["crop"], data["augment"]) == (None, False)
        assert config["trainer"]["max_epochs"] in (None, -1)
    config = jobs["fcn_prob_dogma_seed0"].config
    model, data = config["model"]["init_args"], config["data"]
    assert (config["model"]["class_path"], model["width"], model["lr"]) == ("envpred.models.FCNForecaster", 1.0, 1e-4)
    assert data["batch_size"] == 50
    assert model["max_epochs"] * data["samples"] / data["batch_size"] == 1975


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["small", "full"])
def test_what_is_planned_is_read_again_as_it_was_written(preset: str, tmp_path: Path) -> None:
    """Each run gets its configuration as a file; all of them judge the same windows."""
    judged = set()
    for name, job in jobs_of(preset, tmp_path).items():
        file = tmp_path / f"{name}.yaml"
        file.write_text(as_yaml(dict(job.config)), encoding="utf-8")
        again = FitArguments([f"--config={file}", *logged_to(job.folder)]).base
        assert {key: again[key] for key in ("model", "data", "seed_everything")} == {
            key: job.config[key] for key in ("model", "data", "seed_everything")
        }
        if job.run.trains:
            assert again["data"]["variant"] == name.removesuffix("_seed0").split("_", 1)[1]
        judged.add(str({key: again["data"][key] for key in FIXED if key != "variant"}))
    assert len(judged) == 1


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


def test_figures_are_of_the_drives_that_are_tested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of four drives would test, were none named."""
    cameras: dict[str, object] = {}
    drawn: list[str] = []
    monkeypatch.setattr(module, "execute", lambda *_: [])
    for made in ("simulate", "grids", "show_plan"):
        monkeypatch.setattr(module, made, put_in_order)
    for picture in ("ground", "velocity"):
        monkeypatch.setattr(module, picture, lambda source, file, name, frame: drawn.append(name))
    monkeypatch.setattr(module, "camera_of", lambda name, source: None)
    monkeypatch.setattr(module, "paper_page", lambda results, out, figures, told, *_: cameras.update(told))
    write_store(tmp_path / "grids", {name: list(range(40)) for name in "abcd"}, cells=64, dogma=True, context=128)
    module.main(["--out", str(tmp_path), "--data.test=[a]"])
    assert list(cameras) == ["a"]
    assert set(drawn) == {"a"}


def test_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module.main(["--out", str(tmp_path / "out"), "--dry_run"])
    said = capsys.readouterr().out
    assert "40 of 45 frames are simulated" in said
    assert "train and test: prednet_prob_dogma_seed0" in said
    assert "test: rollout" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_networks_of_small_are_trained_and_tested(tmp_path: Path) -> None:
    """A step of each: the sizes that the demo does not train."""
    store = write_store(tmp_path / "grids", {name: list(range(40)) for name in "abc"}, cells=64, dogma=True)
    step = ["--data.samples=1", "--data.batch_size=1", "--trainer.max_epochs=1"]
    runs = {run.name: run for run in published_plan(PRESETS["small"], step, {}, [0])}
    for name in ("prednet_prob_dogma_seed0", "fcn_prob_dogma_seed0"):
        job = Job.of(runs[name], store, tmp_path / "runs")
        job.do()
        assert job.is_done()
        told = read_result(job.result)
        assert (told["model"]["name"], told["variant"]) == tuple(name.removesuffix("_seed0").split("_", 1))


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
