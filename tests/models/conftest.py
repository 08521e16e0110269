from pathlib import Path

import pytest

from tests.store.stores import write_store


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three drives on a grid of 16 x 16 cells; never written to."""
    return write_store(tmp_path_factory.mktemp("store") / "grids", {name: list(range(24)) for name in "abc"})
