"""`python -m sweeps.tune` as a user calls it, with trials that train nothing, and once with trials that do."""

import csv
import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from envpred.cli import main as envpred
from envpred.cli.arguments import FitArguments
from envpred.errors import UserError
from sweeps.study.best import BEST
from sweeps.tune import main, tune
from tests.remedies import remedy
from tests.store.stores import write_store
from tests.sweeps.conftest import SMALL, tuning


def failed(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that fails."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("envpred tune: ")]
    return line


@pytest.mark.usefixtures("stubbed")
def test_a_study_leaves_the_best_a_table_and_pictures(store: Path, space_file: Path, tmp_path: Path) -> None:
    main(tuning(store, space_file, tmp_path / "out", "--trials=4", "--pruner=none"))
    folder = tmp_path / "out" / "prednet_dst_static"
    rows = list(csv.DictReader((folder / "trials.csv").open()))
    assert [row["state"] for row in rows] == ["COMPLETE"] * 4
    best = min(rows, key=lambda row: float(row["val_mse"]))
    assert float(best["val_mse"]) == pytest.approx(2 * float(best["model.t1_lr"]), rel=1e-6)  # as the stub says
    text = (folder / BEST).read_text()
    for line in (f"# trial: {best['trial']}", "# study: prednet_dst_static", "# data: ", "# revision: ", "# space: "):
        assert line in text
    found = yaml.safe_load(text)
    assert found["model"]["init_args"]["t1_lr"] == float(best["model.t1_lr"])
    trial = yaml.safe_load((folder / "trials" / f"{int(best['trial']):04d}" / "trial.yaml").read_text())
    assert found == trial | {"pictures": {"windows": 2, "every_n_epochs": 1}}  # which trials do without
    assert trial["pictures"]["every_n_epochs"] == 0
    for name in ("history", "importances", "parallel_coordinates", "intermediate_values"):
        assert min(Image.open(folder / f"{name}.png").size) > 300
    # A trial's row in HPARAMS is that of its own run, which the stub does not write.
    assert not list((folder / "trials").rglob("events.out.tfevents*"))


@pytest.mark.usefixtures("stubbed")
def test_best_is_used_as_it_is(store: Path, space_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    main(tuning(store, space_file, tmp_path / "out", "--trials=1", "--variant=prob_dogma"))
    best = str(tmp_path / "out" / "prednet_prob_dogma" / BEST)
    envpred(["fit", "--config", best, "--trainer.enable_progress_bar=false", "--trainer.max_epochs=1"])
    again = yaml.safe_load(
        (tmp_path / "runs" / "fit" / "prednet" / "prob_dogma" / "version_0" / "config.yaml").read_text()
    )
    assert again["data"]["variant"] == "prob_dogma"
    assert again["model"] == FitArguments([f"--config={best}"]).base["model"]


@pytest.mark.usefixtures("stubbed")
def test_studies_of_other_grids_spaces_and_configurations_are_refused(
    store: Path, space_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--trials=1", "--name=s"]
    main(tuning(store, space_file, tmp_path, *common))
    other = write_store(tmp_path / "other", {name: list(range(40)) for name in "abc"}, seed=5)
    line = failed(tuning(other, space_file, tmp_path, *common), capsys)
    assert "made with another data" in line
    assert "configuration" not in line  # a store may lie anywhere
    changed = tuning(store, space_file, tmp_path, *common, "--data.samples=4")
    line = failed(changed, capsys)
    assert "another configuration" in line
    (name,), force = remedy(line)
    main([*changed, *force])
    main([*changed, f"{name}=u"])
    space_file.write_text("model.t1_lr: {low: 1e-4, high: 1e-3}", encoding="utf-8")
    assert "another space" in failed(tuning(store, space_file, tmp_path, *common), capsys)
    line = failed(tuning(store, space_file, tmp_path, *common, "--force=true"), capsys)
    assert "model.t1_lr was searched otherwise in trial 0" in line
    ((name,),) = remedy(line)
    main(tuning(store, space_file, tmp_path, "--trials=1", f"{name}=t"))
    space_file.write_text("model.t1_lr: {low: 1e-4, high: 1e-3, log: true}", encoding="utf-8")
    main(tuning(store, space_file, tmp_path, *common, "--trials=2", "--force=true"))


@pytest.mark.usefixtures("stubbed")
def test_mistakes_are_one_line_before_the_first_trial(
    store: Path, space_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert "none of this name ships" in failed(tuning(store, tmp_path / "no.yaml", out), capsys)
    assert "no store of grids" in failed(tuning(tmp_path / "nothing", space_file, out), capsys)
    assert "no input variant 'dst'" in failed(tuning(store, space_file, out, "--variant=dst"), capsys)
    assert "not reachable" in failed(tuning(store, space_file, out, "--storage=sqlite:////no/such/a.db"), capsys)
    for name in ("workers", "trials", "max_failures"):
        line = failed(tuning(store, space_file, out, f"--{name}=0"), capsys)
        assert line == f"envpred tune: --{name} 0: give a number of at least 1"
    assert "--grace 0: give a number above 0" in failed(tuning(store, space_file, out, "--grace=0"), capsys)
    assert "--seed -1: give a number of" in failed(tuning(store, space_file, out, "--seed=-1"), capsys)
    assert "no Dask scheduler" in failed(tuning(store, space_file, out, "--cluster=tcp://127.0.0.1:1"), capsys)
    space_file.write_text("model.t1_lrr: {low: 1e-4, high: 1e-3}", encoding="utf-8")
    assert "did you mean model.t1_lr?" in failed(tuning(store, space_file, out), capsys)
    options = [option for option in tuning(store, space_file, out) if not option.startswith("--config")]
    (config,) = remedy(failed(options, capsys))
    assert "did you mean model.t1_lr?" in failed([*config, *options], capsys)  # which comes after
    (tmp_path / "file").write_text("")
    space_file.write_text("model.t1_lr: {low: 1e-4, high: 1e-3}", encoding="utf-8")
    line = failed(tuning(store, space_file, tmp_path / "file"), capsys)
    assert "Not a directory" in line
    ((option,),) = remedy(line)
    main([*tuning(store, space_file, tmp_path / "file", "--trials=1"), f"{option}={tmp_path / 'other'}"])
    assert not (out / "prednet_dst_static" / "trials").exists()


@pytest.mark.usefixtures("stubbed")
def test_failing_trials_end_in_their_reason(
    store: Path, space_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    space_file.write_text("model.t1_lr: {low: 2e-3, high: 1e-2}", encoding="utf-8")
    monkeypatch.setenv("STUB_FAIL", "CUDA out of memory")
    line = failed(tuning(store, space_file, tmp_path, "--trials=2", "--max_failures=2"), capsys)
    assert "the last 2 trials" in line
    assert "CUDA out of memory" in line


def test_workers_here_and_on_a_cluster_are_given_the_same_options(
    store: Path, space_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: dict[str, Any] = {}

    def command_line(name: str, options: Mapping[str, Any], fit: list[str]) -> list[str]:
        told.update(options, fit=fit)
        return [name]

    def start(place: str | int, *command: str | list[str]) -> None:
        told["started"] = (place, *command)
        raise UserError("enough")

    monkeypatch.setattr("sweeps.tune.command_line", command_line)
    monkeypatch.setattr("sweeps.tune.on_cluster", start)
    monkeypatch.setattr("sweeps.tune.beside", start)
    given = {"trials": 7, "seed": 3, "grace": 9.0, "max_failures": 2, "sampler": "random", "pruner": "hyperband"}
    given |= {"workers": 3}
    options = [*(f"--{name}={value}" for name, value in given.items()), "--force=true"]
    assert "enough" in failed(tuning(store, space_file, tmp_path, *options, "--cluster=tcp://somewhere"), capsys)
    assert told.keys() - {"started"} == inspect.signature(tune).parameters.keys() - {"cluster"}
    assert {name: told[name] for name in given} == given
    assert (told["started"], told["force"]) == (("tcp://somewhere", ["tune"]), True)
    assert (told["variant"], told["space"], told["store"], told["out"]) == (
        "dst_static",
        str(space_file),
        store,
        tmp_path,
    )
    assert "--data.samples=3" in told["fit"]
    on_a_cluster = dict(told)
    told.clear()
    assert "enough" in failed(tuning(store, space_file, tmp_path, *options), capsys)
    assert told.pop("started") == (3, "tune", ["tune"])
    assert told == {name: value for name, value in on_a_cluster.items() if name not in ("workers", "started")}


def test_a_spaces_own_configuration_is_taken(store: Path, space_file: Path, tmp_path: Path, stubbed: None) -> None:
    space_file.write_text(f"config: {SMALL}\nmodel.t1_lr: {{low: 1e-4, high: 1e-3}}", encoding="utf-8")
    options = [option for option in tuning(store, space_file, tmp_path / "out") if not option.startswith("--config")]
    main([*options, "--trials=1"])
    assert "channels: [16, 32, 64]" in (tmp_path / "out" / "prednet_dst_static" / BEST).read_text()


def test_messages_say_the_command_that_was_given(
    tmp_path: Path, space_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(tuning(tmp_path / "nothing", space_file, tmp_path))
    assert capsys.readouterr().err.startswith("envpred tune: ")
    main(["--help"])
    assert capsys.readouterr().out.startswith("usage: envpred tune ")
