"""What tests of the command line share."""

from pathlib import Path

import pytest

from envpred.cli.arguments import FitArguments
from tests.store.stores import write_store

SMALL = Path(__file__).resolve().parents[2] / "configs" / "model" / "prednet_small.yaml"


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> FitArguments:
    """Arguments of a small PredNet on a tiny store."""
    store = write_store(tmp_path_factory.mktemp("cli") / "grids", {"a": list(range(40))})
    return FitArguments([f"--config={SMALL}", f"--data.store={store}", "--data.crop=null", "--model.t1_epochs=1"])
