"""What a report refuses, and why."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.models import FCNForecaster, ParticleForecast, PredNetForecaster
from envpred.report import report
from envpred.report.runs import read_runs
from envpred.results.scenes import read_scenes, write_scenes
from tests.remedies import commands
from tests.report.conftest import draw_windows

MakeRun = Callable[..., Path]
Record = dict[str, Any]
Mend = Callable[[object], Path]


def test_reads_files_folders_and_folders_of_folders(make_run: MakeRun) -> None:
    one, two = make_run(), make_run(FCNForecaster, "prob_dogma")
    for given in ([one, two], [one / "result.json", two / "result.json"], [one.parent], [one.parent, one]):
        assert {run.label for run in read_runs(given)} == {"PredNet, DST static", "FCN, probability DOGMa"}
    (run,) = read_runs([one])
    assert run.mse.mean.shape == (15,)
    assert run.mse.per_window is not None
    assert run.mse.per_window.shape == (30, 15)
    assert run.metrics["skill"].per_window is None
    assert run.reliability is not None
    assert np.isnan(run.reliability["occupied"][0, 0])


def test_same_method_twice_is_told_apart(make_run: MakeRun) -> None:
    labels = [run.label for run in read_runs([make_run(), make_run(change=lambda r: r.update(seed=7))])]
    assert labels == ["PredNet, DST static, seed 3", "PredNet, DST static, seed 7"]
    same = [run.label for run in read_runs([make_run(), make_run()])]
    assert len(set(same)) == 2


def test_undefined_values_stay_undefined(make_run: MakeRun) -> None:
    def change(record: Record) -> None:
        iou = record["metrics"]["iou"]
        iou["per_window"] = [[None, *row[1:]] for row in iou["per_window"]]
        iou["mean"][0] = iou["standard_error"][0] = None

    (run,) = read_runs([make_run(change=change)])
    assert np.isnan(run.metrics["iou"].mean[0])


def told(key: str, value: object) -> Callable[[Record], object]:
    return lambda record: record["data"].update({key: value})


def cut_horizons(record: Record) -> None:
    record["horizon_s"] = record["horizon_s"][:10]
    for metric in record["metrics"].values():
        for key, value in metric.items():
            if isinstance(value, list):
                metric[key] = [row[:10] for row in value] if key == "per_window" else value[:10]


MIXED = {
    "other grids .built again since": told("store_hash", "other"),
    "other split: reference against auto": told("split", "reference"),
    "other number of frames shown: 4 against 5": told("given", 4),
    "other window length: 25 against 20": told("length", 25),
    "other test drives": told("drives", ["drive_c"]),
    "other test windows": told("windows", [["drive_a", 7 * n] for n in range(30)]),
    "other horizons": cut_horizons,
    "other window rule": told("window_rule", "every window"),
    "static baseline differs": lambda r: r["metrics"].update(static_mse=r["metrics"]["mse"]),
}


@pytest.mark.parametrize("reason", MIXED)
def test_mixed_results_are_refused(make_run: MakeRun, tmp_path: Path, mend: Mend, reason: str) -> None:
    one, two = make_run(), make_run(FCNForecaster, "prob_dogma", change=MIXED[reason])
    with pytest.raises(UserError, match=reason) as refusal:
        report([one, two], tmp_path / "out")
    assert str(two) in str(refusal.value)
    assert not (tmp_path / "out").exists()
    if commands(str(refusal.value)):
        assert report([mend(refusal.value)], tmp_path / "out").is_file()


def test_other_velocities_are_refused_whatever_stands_between(make_run: MakeRun, tmp_path: Path, mend: Mend) -> None:
    """What is judged is the same for all variants, so only what reads velocities tells that they were built anew."""
    velocities = [{"velocity": hashed, "velocity_cov": "same"} for hashed in ("first", "second")]
    static = make_run(PredNetForecaster, "prob_static")
    one = make_run(PredNetForecaster, "prob_dogma", change=told("input_hash", velocities[0]))
    again = make_run(FCNForecaster, "prob_dogma", change=told("input_hash", velocities[1]))
    particles = make_run(ParticleForecast, "dst_dogma", change=told("input_hash", {"particle_forecast": "third"}))
    assert len(read_runs([static, one, particles])) == 3  # read other arrays, not another content of one
    assert len(read_runs([one, again], same_inputs=False)) == 2  # where velocities are what is compared
    with pytest.raises(UserError, match=r"read another velocity \(built again since") as refusal:
        report([static, one, again], tmp_path / "out")
    assert str(again) in str(refusal.value)
    assert str(one) in str(refusal.value)
    assert not (tmp_path / "out").exists()
    assert len(read_runs([mend(refusal.value)])) == 1


def swap_windows(folder: Path) -> None:
    result = json.loads((folder / "result.json").read_text())
    result["metrics"]["mse"]["per_window"].reverse()
    (folder / "result.json").write_text(json.dumps(result))


def cut_file(folder: Path) -> None:
    file = folder / "drawn.npz"
    file.write_bytes(file.read_bytes()[:-100])


def cut_cells(folder: Path) -> None:
    with np.load(folder / "drawn.npz") as arrays:
        changed = dict(arrays) | {"centre_cell": arrays["centre_cell"][:, :-1]}
    np.savez(folder / "drawn.npz", **changed)


DRAWN: dict[str, Callable[[Path], object]] = {
    r"drawn\.npz: missing": lambda folder: (folder / "drawn.npz").unlink(),
    r"drawn\.npz: damaged": cut_file,
    "has cells for other frames than it holds": cut_cells,
    "holds other forecasts than .*result.json judged": swap_windows,
}


@pytest.mark.parametrize("reason", DRAWN)
def test_forecasts_that_do_not_fit_their_result_are_refused(
    make_run: MakeRun, tmp_path: Path, mend: Mend, reason: str
) -> None:
    folder = make_run()
    draw_windows(folder)
    DRAWN[reason](folder)
    with pytest.raises(UserError, match=reason) as refusal:
        report([folder], tmp_path / "out")
    assert str(folder) in str(refusal.value)
    assert not (tmp_path / "out").exists()
    assert f"delete {folder} and" in str(refusal.value)
    assert len(read_runs([mend(refusal.value)])) == 1


def test_forecasts_judged_on_other_grids_are_refused(make_run: MakeRun, tmp_path: Path) -> None:
    one, two = make_run(), make_run(FCNForecaster, "prob_dogma")
    for folder in (one, two):
        draw_windows(folder)
    scenes = read_scenes(two / "drawn.npz", "fcn")
    lower = {
        k: replace(s, target=s.target - 0.1, forecasts={"fcn": s.forecasts["fcn"] - 0.1}) for k, s in scenes.items()
    }
    write_scenes(two / "drawn.npz", lower)
    with pytest.raises(UserError, match=r"FCN, probability DOGMa was judged on other grids of drive_0, frame 4"):
        report([one, two], tmp_path / "out")


def drop_windows(record: Record) -> None:
    record["metrics"]["mse"]["per_window"] = record["metrics"]["mse"]["per_window"][:12]


def drop_horizons(record: Record) -> None:
    record["metrics"]["iou"]["mean"] = record["metrics"]["iou"]["mean"][:4]


def change_mean(record: Record) -> None:
    record["metrics"]["mse"]["mean"][3] *= 0.9


def cut_diagram(record: Record) -> None:
    record["metrics"]["reliability"] = {key: rows[:4] for key, rows in record["metrics"]["reliability"].items()}


PARTIAL: dict[str, Callable[[Record], object]] = {
    "format 3, this version reads 4": lambda r: r.update(format=3),
    "partial, mse has 12 of the 30 windows": drop_windows,
    "partial, iou has 4 of the 15 horizons": drop_horizons,
    "damaged, the mean of mse": change_mean,
    "partial, reliability has 4 of the 15 horizons": cut_diagram,
    "metrics: holds signs that do not belong there": lambda r: r["metrics"].update({"../../iou": r["metrics"]["iou"]}),
    "missing required field variant": lambda r: r.pop("variant"),
    "missing required field role": lambda r: r.pop("role"),
    "iou: .*missing required field unit": lambda r: r["metrics"]["iou"].pop("unit"),
    "iou: direction: Invalid enum value 'up'": lambda r: r["metrics"]["iou"].update(direction="up"),
    "data: .*missing required field input_hash": lambda r: r["data"].pop("input_hash"),
    "data: .*missing required field windows": lambda r: r["data"].pop("windows"),
    "incomplete, no mean squared error per window": lambda r: r["metrics"].pop("mse"),
    "no mean squared error per window": lambda r: r["metrics"]["mse"].pop("per_window"),
    "metrics.*got null; delete it and run `envpred test` again": lambda r: r["metrics"].update(iou=None),
    "cannot be read": lambda r: r.update(pictures={"strip": "gone.png"}),
    "not a picture": lambda r: r.update(pictures={"strip": "result.json"}),
}


@pytest.mark.parametrize("reason", PARTIAL)
def test_partial_and_damaged_results_are_refused(make_run: MakeRun, tmp_path: Path, mend: Mend, reason: str) -> None:
    folder = make_run(change=PARTIAL[reason])
    with pytest.raises(UserError, match=reason) as refusal:
        report([folder], tmp_path / "out")
    assert str(folder) in str(refusal.value)
    assert not (tmp_path / "out").exists()
    if commands(str(refusal.value)):
        assert len(read_runs([mend(refusal.value)])) == 1


def test_unreadable_and_missing_results_are_refused(make_run: MakeRun, tmp_path: Path, mend: Mend) -> None:
    folder = make_run()
    text = (folder / "result.json").read_text()
    contents: dict[str, tuple[list[Path], str]] = {
        "cannot be read as JSON": ([folder], text[: len(text) // 2]),
        "format None": ([folder], json.dumps([1, 2])),
        r"nowhere: no such file or folder": ([make_run(), tmp_path / "nowhere"], text),
        "no test run given": ([], text),
    }
    for reason, (given, content) in contents.items():
        (folder / "result.json").write_text(content)
        with pytest.raises(UserError, match=reason) as refusal:
            read_runs(given)
        if commands(str(refusal.value)):
            assert len(read_runs([mend(refusal.value)])) == 1


def test_folders_without_a_result_are_left_out(
    make_run: MakeRun, tmp_path: Path, mend: Mend, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `envpred report runs/*/*/version_*` names them: runs of training beside those of tests."""
    trained = [tmp_path / f"version_{n}" for n in range(6)]
    for folder in trained:
        folder.mkdir()
    tested = make_run()
    capsys.readouterr()
    assert [run.file.parent for run in read_runs([trained[0], tested])] == [tested]
    assert capsys.readouterr().err == f"skipped 1 folder without result.json: {trained[0]}\n"
    assert len(read_runs([*trained, tested])) == 1
    first, some = str(trained[0]), ", ".join(map(str, trained[:4]))
    assert capsys.readouterr().err == f"skipped 6 folders without result.json: {some} and 2 more\n"
    with pytest.raises(UserError, match=rf"^{first}, .* and 2 more: no result\.json there; run `envpred test` first"):
        read_runs(trained)
    with pytest.raises(UserError, match=rf"^{first}: no result\.json there") as refusal:
        read_runs([trained[0]])
    assert capsys.readouterr().err == ""
    assert len(read_runs([mend(refusal.value)])) == 1
    capsys.readouterr()
    read_runs([tested])
    assert capsys.readouterr().err == ""


def test_random_weights_are_called_untrained(make_run: MakeRun) -> None:
    (run,) = read_runs([make_run(change=lambda record: record["model"].update(untrained=True))])
    assert run.label == "PredNet, DST static, untrained"
