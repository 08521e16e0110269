"""`python -m tests.sweeps.stub ...`: sweeps.tune whose trials train nothing, but leave what `envpred fit` leaves.

The error is a function of the learning rate, the second validation is the best checkpoint's.  $STUB_SECONDS is how long
a trial takes, and $STUB_FAIL what trials of a large learning rate say when they fail.
"""

import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

STEPS = 10  # a validation


def train(config: Path, folder: Path) -> None:
    """What a run of `envpred fit` leaves: its validations, and which of them the best checkpoint is of."""
    import yaml

    from envpred.results.validations import VALIDATIONS, History
    from envpred.store.files import write_json

    model = yaml.safe_load(config.read_text(encoding="utf-8"))["model"]["init_args"]
    epochs = model["t1_epochs"] + model["t5_epochs"]
    if os.environ.get("STUB_FAIL") and model["t1_lr"] > 1e-3:
        print("loading\nenvpred: " + os.environ["STUB_FAIL"])
        sys.exit(1)
    history = History([], {})
    for epoch in range(epochs):
        time.sleep(float(os.environ.get("STUB_SECONDS", "0")) / epochs)
        mse = model["t1_lr"] * (epochs - epoch)
        history.validations.append(
            {"epoch": epoch, "step": STEPS * epoch, "stage": None, "val_mse": mse, "static_mse": 1.0, "horizons": {}}
        )
        write_json(folder / VALIDATIONS, history.as_json())
    history.best["best.ckpt"] = {"monitor": "val/loss", "score": 0.5, "validation": 1}
    write_json(folder / VALIDATIONS, history._replace(ended=epochs).as_json())


def command_line(name: str, options: Mapping[str, Any], fit: list[str]) -> list[str]:
    """In place of `sweeps.runs.command.command_line`: workers that train nothing, either."""
    from sweeps.runs import command

    python, _, _, *given = command.command_line(name, options, fit)
    return [python, "-m", "tests.sweeps.stub", *given]


def command(config: Path, folder: Path) -> list[str]:
    """In place of `sweeps.runs.trial.fit`."""
    return [sys.executable, __file__, "fit", str(config), str(folder)]


if __name__ == "__main__":
    if sys.argv[1] == "fit":
        train(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        from sweeps import tune

        with patch.object(tune, "fit_command", command), patch.object(tune, "command_line", command_line):
            tune.main(sys.argv[1:])
