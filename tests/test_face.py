"""What a program of the user's imports: the names of `import envpred`, and the README's lines as they stand there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import envpred
from envpred.cli import main
from envpred.errors import UserError
from tests.drives.synthetic import write_drive
from tests.models.trainers import LEAST

REPOSITORY = Path(__file__).resolve().parents[1]


def test_importing_it_loads_nothing_heavy() -> None:
    heavy = "{'numpy', 'torch', 'lightning', 'numba', 'matplotlib'}"
    text = f"import sys, envpred; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_name_of_the_face_is_there() -> None:
    for name in envpred.__all__:
        assert getattr(envpred, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = envpred.nothing


def test_from_a_scan_folder_to_a_forecast_as_the_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tiny PredNet is trained on a drive; the README's lines then map the drive and forecast it."""
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "drives", frames=40, azimuths=360)
    main(["grids", "--source", "drives", "--store", "grids", "--workers", "1"])
    quick = ["--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1", "--data.samples=2", "--data.crop=32"]
    quiet = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false"]
    main(["fit", "--model=PredNetForecaster", "--data.store=grids", "--data.length=7", *quick, *quiet])
    (snippet,) = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL)
    (checkpoint,) = (tmp_path / "runs").rglob("best.ckpt")
    lines = snippet.replace("KITTI_ROOT", "drives").replace("best.ckpt", str(checkpoint))
    assert len([line for line in lines.splitlines() if line.strip()]) <= 10
    names: dict[str, object] = {}
    exec(lines, names)
    forecast = names["forecast"]
    assert isinstance(forecast, torch.Tensor)
    assert forecast.shape == (15, 128, 128)
    assert 0 <= forecast.min() < forecast.max() <= 1


def test_a_checkpoint_that_is_none_is_refused(tmp_path: Path) -> None:
    torch.save(LEAST | {"class_path": "envpred.models.Missing", "hyper_parameters": {}}, tmp_path / "a.ckpt")
    with pytest.raises(UserError, match=r"a\.ckpt: names 'envpred\.models\.Missing', which Python does not find"):
        envpred.load_forecaster(tmp_path / "a.ckpt")
    torch.save(LEAST | {"class_path": "numpy.ndarray", "hyper_parameters": {}}, tmp_path / "b.ckpt")
    with pytest.raises(UserError, match=r"b\.ckpt: numpy\.ndarray is no forecaster"):
        envpred.load_forecaster(tmp_path / "b.ckpt")
    torch.save(LEAST | {"hyper_parameters": {}}, tmp_path / "d.ckpt")
    with pytest.raises(UserError, match=r"d\.ckpt: names '', which Python does not find"):
        envpred.load_forecaster(tmp_path / "d.ckpt")
    file = tmp_path / "c.ckpt"
    torch.save(LEAST | {"class_path": "envpred.models.PredNetForecaster", "hyper_parameters": {}}, file)
    with pytest.raises(UserError, match=r"c\.ckpt: its weights are not those of envpred\.models\.PredNetForecaster"):
        envpred.load_forecaster(file)


@pytest.mark.parametrize(
    "told",
    [
        {"class_path": "stranger.Own", "hyper_parameters": {}},
        {"class_path": "envpred.models.PredNetForecaster", "hyper_parameters": {"variant": "stranger.OWN"}},
        {"class_path": "envpred.__main__.Own", "hyper_parameters": {}},
    ],
    ids=["class", "variant", "command line"],
)
def test_a_checkpoint_runs_no_code_that_nobody_chose(
    told: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stranger.py").write_text("raise SystemExit('run')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "envpred.__main__", raising=False)
    torch.save(LEAST | told, tmp_path / "a.ckpt")
    said = r"a\.ckpt: names '.*', and its code would run; if you trust '(stranger|envpred\.__main__)', import it before"
    with pytest.raises(UserError, match=said):
        envpred.load_forecaster(tmp_path / "a.ckpt")
    if told["class_path"] != "envpred.__main__.Own":
        with pytest.raises(SystemExit, match="run"):
            envpred.load_forecaster(tmp_path / "a.ckpt", trusted=["stranger"])
