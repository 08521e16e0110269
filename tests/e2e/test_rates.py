"""A drive of 20 Hz is forecast 1.5 s ahead: by 30 steps, or by every second scan."""

import json
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.results.result import RESULT
from tests.store.stores import write_store

QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--data.split=custom", "--data.test=[a]"]


@pytest.mark.parametrize(("stride", "steps", "said"), [(1, 30, "30 forecasts 0.05 s apart"), (2, 15, "")])
def test_a_drive_of_20_hz(
    stride: int,
    steps: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_store(tmp_path / "grids", {"a": list(range(90))}, period=0.05)
    main(["test", "--model=LastFrame", "--data.store=grids", f"--data.stride={stride}", *QUIET])
    (result,) = Path("runs").rglob(RESULT)
    told = json.loads(result.read_text())
    np.testing.assert_allclose(told["horizon_s"], 1.5 * np.arange(1, steps + 1) / steps)
    assert told["data"]["period"] == 0.05 * stride
    assert len(told["metrics"]["mse"]["mean"]) == steps
    assert (said in caplog.text + capfd.readouterr().err) or not said
    main(["report", str(result), "--out", "report"])
    head = (tmp_path / "report" / "methods.md").read_text()
    assert all(f"{seconds} s" in head for seconds in ("0.1", "0.5", "1.0", "1.5"))
