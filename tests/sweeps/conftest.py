"""What the tests of sweeps share: a tiny store, a space, and the options of runs that take a second."""

from pathlib import Path

import pytest

from envpred.cli.arguments import FitArguments
from tests.store.stores import write_store
from tests.sweeps import stub

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = REPOSITORY / "configs" / "model" / "prednet_small.yaml"

SPACE = """
model.channels: {choices: [[4], [4, 4]]}
model.t1_lr: {type: float, low: 1e-4, high: 1e-2, log: true}
model.layer_weights: {list: [1.0, {type: float, low: 0.01, high: 1.0, log: true}]}
model.t5_lr: {low: 1e-4, high: 1e-2, log: true, when: {model.channels: [[4, 4]]}}
"""


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(40)) for name in ("a", "b", "c")}
    return write_store(tmp_path_factory.mktemp("sweeps") / "grids", drives, dogma=True)


@pytest.fixture(scope="session")
def fit(store: Path) -> FitArguments:
    """Runs of a small PredNet on the tiny store."""
    return FitArguments(
        [f"--config={SMALL}", f"--data.store={store}", "--model.t1_epochs=1", "--model.t5_epochs=2", "--data.crop=null"]
    )


@pytest.fixture
def space_file(tmp_path: Path) -> Path:
    file = tmp_path / "space.yaml"
    file.write_text(SPACE)
    return file


@pytest.fixture
def stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of `sweeps.tune` train nothing."""
    monkeypatch.setattr("sweeps.tune.fit_command", stub.command)


def tuning(store: Path, space: Path, out: Path, *more: str) -> list[str]:
    """A command line of `sweeps.tune`."""
    given = {"variant": "dst_static", "store": store, "space": space, "out": out, "config": SMALL}
    quick = ["--model.t1_epochs=1", "--model.t5_epochs=2", "--data.samples=3", "--data.crop=null"]
    return [*(f"--{name}={value}" for name, value in given.items()), *quick, *more]
