"""A small drive with a gap."""

import pytest

from envpred.drives import Drive
from tests.live.replays import small_drive


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """See `small_drive`."""
    return small_drive(tmp_path_factory.mktemp("drives"))
