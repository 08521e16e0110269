"""`python -m tests.sweeps.stub ...`: sweeps.tune whose trials train nothing, but leave what `envpred fit` leaves.

The error is a function of the learning rate.  $STUB_SECONDS is how long a trial takes, $STUB_CHECKPOINT the file that
stands for its best checkpoint (of step 20), and $STUB_FAIL what trials of a large learning rate say when they fail.
"""

import os
import shutil
import sys
import time
from pathlib import Path
from unittest.mock import patch

STEPS = 10  # a validation


def train(config: Path, folder: Path) -> None:
    """What a run of `envpred fit` leaves: validations in TensorBoard's events, and the best checkpoint."""
    import yaml
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.summary.writer.event_file_writer import EventFileWriter

    model = yaml.safe_load(config.read_text())["model"]["init_args"]
    epochs = model["t1_epochs"] + model["t5_epochs"]
    if os.environ.get("STUB_FAIL") and model["t1_lr"] > 1e-3:
        print("loading\nenvpred: " + os.environ["STUB_FAIL"])
        sys.exit(1)
    writer = EventFileWriter(str(folder))
    for epoch in range(epochs):
        time.sleep(float(os.environ.get("STUB_SECONDS", "0")) / epochs)
        for tag, value in (("epoch", epoch), ("val/mse", model["t1_lr"] * (epochs - epoch))):
            summary = Summary(value=[Summary.Value(tag=tag, simple_value=value)])
            writer.add_event(Event(step=STEPS * (epoch + 1) - 1, wall_time=time.time(), summary=summary))
        writer.flush()
    writer.close()
    (folder / "checkpoints").mkdir()
    shutil.copy(os.environ["STUB_CHECKPOINT"], folder / "checkpoints" / "best.ckpt")


def command(config: Path, folder: Path) -> list[str]:
    """In place of `sweeps.runs.trial.fit`."""
    return [sys.executable, __file__, "fit", str(config), str(folder)]


if __name__ == "__main__":
    if sys.argv[1] == "fit":
        train(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        from sweeps import tune

        with patch.object(tune, "fit_command", command):
            tune.main(sys.argv[1:])
