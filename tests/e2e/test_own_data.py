"""What docs/own_data.md shows is done: its settings and commands, on recordings of a scanner and car of its own."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from envpred.cli import main
from envpred.drives import find_drives
from envpred.gate import conform
from envpred.gate.folders import Recording
from envpred.mapping.trajectory import poses_at
from envpred.results.predictions import Predictions
from envpred.store import Store
from tests.drives import own

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own_data.md"
FRAMES = 45
FIRST = 1_714_550_400_000_000_000  # nanoseconds
RIGHT = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])  # axes x right, y forward, z up, along the car's
SHORT = {
    "envpred fit": ["--data.samples=2", "--model.max_epochs=1", "--model.futures=2", "--data.val_windows=1"],
    "envpred test": ["--model.futures=2"],
}
QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--pictures.every_n_epochs=0"]


def blocks(kind: str) -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [text for word, text in found if word == kind]


def commands() -> list[str]:
    return [line for block in blocks("") for line in block.splitlines() if line.startswith("envpred ")]


def write(folder: Path, recorded: own.Recorded) -> None:
    """A recording as the page says: `.pcd` named by nanoseconds, x to the right; poses at 50 Hz, 0.5 s ahead."""
    (folder / "lidar").mkdir(parents=True)
    (folder / "trajectory").mkdir()
    (folder / "envpred.yaml").write_text(blocks("yaml")[0])
    for time, points in zip(recorded.times, recorded.scans, strict=True):
        turned = np.column_stack([points[:, :3] @ RIGHT, points[:, 3]]).astype(np.float32)
        own.write_scan(folder / "lidar" / f"{FIRST + round(time * 1e9)}.pcd", turned)
    times = np.arange(0.0, recorded.times[-1] + 0.01, 0.02)
    sensor = poses_at(times, recorded.times, recorded.sensor)
    quaternions = Rotation.from_matrix(sensor[:, :3, :3] @ RIGHT).as_quat()
    rows = np.column_stack([FIRST * 1e-9 + times + 0.5, sensor[:, :3, 3], quaternions])
    np.savetxt(folder / "trajectory" / "path.txt", rows, "%.9f")


def test_the_settings_on_the_page_are_settings() -> None:
    for block in blocks("yaml"):
        conform({"sensor": {"height": 1.0}, **yaml.safe_load(block)}, Recording, PAGE, "")
    assert [command.split()[1] for command in commands()][:3] == ["check", "grids", "show"]


@pytest.mark.slow
def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    for name, seed in (("monday", 5), ("tuesday", 6)):
        write(tmp_path / "recordings" / name, own.record(FRAMES, 16, 600, seed=seed))
    monday, _ = find_drives(tmp_path / "recordings")
    expected = own.record(FRAMES, 16, 600, seed=5).body
    np.testing.assert_allclose(monday.poses, expected, atol=2e-3)
    for command in commands():
        added = next((more for start, more in SHORT.items() if command.startswith(start)), [])
        lightning = command.split()[1] in ("fit", "test", "predict")
        main([*shlex.split(command)[1:], *added, *(QUIET if lightning else [])])
    said = capsys.readouterr().out
    assert "monday: 45 frames, nothing looks wrong" in said
    assert "tuesday: 45 frames, nothing looks wrong" in said
    stored = Store(tmp_path / "grids").drives["monday"]
    assert stored.manifest["body"] == own.BODY
    assert stored.array("context_label").shape == (FRAMES, 256, 256)
    assert Predictions(tmp_path / "newest").forecast(0).shape == (15, 128, 128)
    for picture in ("check/monday.png", "mapping.png", "strip.png", "report/report.html"):
        assert (tmp_path / picture).stat().st_size > 5000
    assert next((tmp_path / "runs" / "fit").rglob("best.ckpt")).is_file()
