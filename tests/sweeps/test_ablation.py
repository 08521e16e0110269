"""`python -m sweeps.ablation` from the plan to the report, with runs of a second in this very process."""

import json
import signal
from pathlib import Path
from typing import Any

import pytest
import yaml

from envpred.callbacks.pictures import Pictures
from envpred.cli import main as envpred
from envpred.interrupts import end_at_once
from envpred.results.result import RESULT
from sweeps.ablation import main
from sweeps.runs.trial import TrialFailedError, logged_to
from sweeps.table.job import CONFIG, SECONDS, Job
from sweeps.table.summary import summary
from tests.remedies import remedy
from tests.store.stores import write_store
from tests.sweeps.conftest import SMALL, tuning


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What envpred is called for; it runs in this process, which has its libraries already."""
    calls: list[str] = []

    def call(job: Job, command: str, *options: str) -> None:
        calls.append(f"{command} {job.run.name}")
        envpred([command, "--config", str(job.folder / CONFIG), *logged_to(job.folder), *options])

    monkeypatch.setattr(Job, "_call", call)
    for hook in ("on_validation_end", "on_test_end"):
        monkeypatch.setattr(Pictures, hook, lambda *_: None)  # drawing takes longer than all else
    return calls


def arguments(store: Path, out: Path, *more: str) -> list[str]:
    quick = [
        "--model.channels=[4]",
        "--model.t1_epochs=1",
        "--model.t5_epochs=1",
        "--data.samples=1",
        "--data.crop=null",
    ]
    choice = ["--variants=[prob_static,prob_dogma]", "--switches=[t5_only]"]
    return [f"--store={store}", f"--out={out}", f"--config={SMALL}", *quick, *choice, *more]


@pytest.mark.slow
def test_from_the_plan_to_the_report_and_not_twice(
    tmp_path: Path, called: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    store = write_store(tmp_path / "grids", {name: list(range(60)) for name in "abc"}, dogma=True)
    out = tmp_path / "out"
    main(arguments(store, out, "--dry_run=true"))
    said = capsys.readouterr().out
    assert "5 of 5 runs and 0 stores to do, about 0:" in said
    assert called == []
    assert not out.exists()

    main(arguments(store, out))
    assert len(called) == 4 * 2 + 1
    text = (out / "sweep.md").read_text()
    assert "| t5_only | 0 |" in text
    assert "one stage instead of two: t+5 alone" in text
    assert "[report](report/variants/report.html)" in text
    for group, compared in (("variants", 3), ("network", 2)):
        assert (out / "report" / group / "report.html").exists()
        table = (out / "report" / group / "methods.md").read_text()
        assert sum(line.startswith("| ") for line in table.splitlines()) >= compared
    (job,) = (out / "runs").glob("t5_only-*")
    assert yaml.safe_load((job / CONFIG).read_text())["pictures"] == {"windows": 2, "every_n_epochs": 0}
    result = json.loads((job / "result.json").read_text())
    assert result["model"]["hyperparameters"]["t1_epochs"] == 0

    called.clear()
    # They are there.
    monkeypatch.setattr("sweeps.ablation.report", lambda results, page, same_inputs: page / "report.html")
    main(arguments(store, out))
    assert called == []
    assert "0 of 5 runs" in capsys.readouterr().out

    for missing in (RESULT, SECONDS):  # interrupted between training and test, and between result and pictures
        (job / missing).unlink()
        called.clear()
        main(arguments(store, out))
        assert called == ["test t5_only"]

    capsys.readouterr()
    main(arguments(store, out, "--data.samples=2", "--dry_run=true"))  # another configuration
    assert "4 of 5 runs" in capsys.readouterr().out  # the baseline does not train


@pytest.mark.slow
def test_the_rollouts_rows_and_the_fixed_frame(
    tmp_path: Path, called: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    drives, out = {name: list(range(40)) for name in "abc"}, tmp_path / "out"
    store = write_store(tmp_path / "grids", drives, cells=32, dogma=True, context=64, frame="ground")
    args = arguments(store, out, "--variants=[]", "--switches=[fixed_context,rollout_1_future,rollout_corrected]")
    main(args)
    tested = {line.removeprefix("test ") for line in called if line.startswith("test")}
    assert tested == {
        *("moved_last_frame", "dst_static_default_seed0", "fixed_context"),
        *("rollout", "rollout_1_future", "rollout_corrected"),
    }
    assert not (out / "stores").exists()
    text = (out / "sweep.md").read_text()
    assert "| 0.1 s / static |" in text
    assert "| the ego's likeliest future alone |" in text
    table = (out / "report" / "rollout" / "methods.md").read_text()
    assert "| Rollout, futures 1 |" in table
    assert "| Moved last frame |" in table
    (job,) = (out / "runs").glob("fixed_context-*")
    told = json.loads((job / RESULT).read_text())["model"]["hyperparameters"]
    assert (told["fixed_frame"], told["context"]) == (True, True)

    called.clear()
    capsys.readouterr()
    main([*args, "--dry_run=true"])  # also what reads more than its variant is known to be done
    assert "0 of 6 runs" in capsys.readouterr().out
    assert called == []


@pytest.mark.slow
def test_results_of_other_grids_are_made_anew(tmp_path: Path, called: list[str]) -> None:
    args = ["--variants=[prob_static]", "--switches=[]", "--model.t5_epochs=0"]
    for seed in (0, 5):
        store = write_store(tmp_path / f"{seed}" / "grids", {name: list(range(40)) for name in "abc"}, seed=seed)
        (tmp_path / "grids").unlink(missing_ok=True)
        (tmp_path / "grids").symlink_to(store)
        main([*arguments(tmp_path / "grids", tmp_path / "out"), *args])
    assert called.count("test prob_static_default_seed0") == 2


def test_a_failed_run_is_told_and_the_others_are_done(
    store: Path, tmp_path: Path, called: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    call = Job._call

    def fail(job: Job, command: str, *options: str) -> None:
        if job.run.name == "t5_only":
            raise TrialFailedError("the forecast is the same everywhere")
        call(job, command, *options)

    handlers: list[object] = []

    def summed(*told: Any) -> str:
        handlers.append(signal.getsignal(signal.SIGTERM))
        return summary(*told)

    monkeypatch.setattr(Job, "_call", fail)
    monkeypatch.setattr("sweeps.ablation.summary", summed)
    with pytest.raises(SystemExit):
        main(arguments(store, tmp_path / "out", "--variants=[dst_static]"))
    assert handlers not in ([], [end_at_once])  # what is written can be put in order when a signal comes
    lines = capsys.readouterr().err.splitlines()
    assert any("t5_only: the forecast is the same everywhere" in line for line in lines)
    assert lines[-1] == "1 of 3 runs and their reports failed; the others are done"
    assert "* failed: t5_only" in (tmp_path / "out" / "sweep.md").read_text()


def test_a_training_that_did_not_reach_its_end_is_not_tested(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Though its exit code says nothing of it."""
    calls: list[str] = []

    def call(job: Job, command: str, *options: str) -> None:
        calls.append(f"{command} {job.run.name}")
        job.result.touch()

    monkeypatch.setattr(Job, "_call", call)
    monkeypatch.setattr("sweeps.ablation._report", lambda *_: {})
    monkeypatch.setattr("sweeps.ablation.summary", lambda *_: "")
    for _ in range(2):  # what is not trained is trained again
        with pytest.raises(SystemExit):
            main(arguments(store, tmp_path / "out", "--variants=[]", "--switches=[t5_only]"))
        assert "t5_only: the run ended after 0 of 2 epochs, before its end" in capsys.readouterr().err
    assert calls.count("fit t5_only") == 2
    assert "test t5_only" not in calls


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--switches=[ransac]"], "give their folder as --source"),
        (["--switches=[one]"], "there are t1_only"),
        (["--seeds=[-1]"], "--seeds -1: give a number of at least 0"),
        (["--workers=0"], "--workers 0: give a number of at least 1"),
        (["--model.chanels=[4]"], "no option chanels; did you mean --model.channels"),
    ],
)
def test_mistakes_are_one_line(
    store: Path, tmp_path: Path, more: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments(store, tmp_path / "out", *more))
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert not (tmp_path / "out").exists()


def refused(args: list[str], capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    """What the user is told to do."""
    with pytest.raises(SystemExit):
        main(args)
    return remedy(capsys.readouterr().err)


@pytest.fixture
def untimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans do not say how long they take, which takes a while to find out."""
    monkeypatch.setattr("sweeps.ablation.show_plan", lambda *_: {})


@pytest.mark.usefixtures("stubbed", "untimed")
def test_what_the_user_is_told_to_do_makes_a_plan(
    store: Path, space_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = arguments(store, tmp_path / "out", "--dry_run=true")
    (tune,), (option,) = refused([*args, f"--tuned={tmp_path}"], capsys)
    main([arg for arg in [*args, f"--tuned={tmp_path}"] if not arg.startswith(option)])
    envpred([tune, *tuning(store, space_file, tmp_path, "--trials=1", "--variant=prob_static")])
    main([*args, f"--tuned={tmp_path}"])
    for (option,) in refused([*args, "--switches=[ransac]"], capsys):
        given = {"--source": f"--source={tmp_path}", "--switches": "--switches=[t5_only]"}[option]
        main([*args, "--switches=[ransac]", given])


@pytest.mark.usefixtures("untimed")
def test_velocities_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = write_store(tmp_path / "plain", {name: list(range(40)) for name in "abc"}, cells=8)
    args = arguments(plain, tmp_path / "out", "--dry_run=true")
    (command,) = refused(args, capsys)
    envpred([*command, "--workers=1", "--particles.filter.persistent=50", "--particles.filter.births=5"])
    main(args)


@pytest.mark.slow
def test_as_processes(store: Path, tmp_path: Path) -> None:
    main(arguments(store, tmp_path / "out", "--variants=[prob_static]"))
    # The variant asked for, the switch and the run that it is compared with, the baseline.
    results = {run.parent.name.rsplit("-", 1)[0] for run in (tmp_path / "out" / "runs").glob(f"*/{RESULT}")}
    assert results == {"prob_static_default_seed0", "t5_only", "dst_static_default_seed0", "moved_last_frame"}
