"""What several test files need: the real drives, where they are to be had."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import user_errors

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True, scope="session")
def _record_user_errors(pytestconfig: pytest.Config) -> Iterator[None]:
    """What the tests provoke of `UserError` is recorded: tests/user_errors.py tells what none does."""
    with pytest.MonkeyPatch.context() as patch:
        user_errors.Recorder(user_errors.record_of(pytestconfig), patch)
        yield


def shared_folder() -> Path:
    """The folder of real drives and reference arrays beside the checkout (or at $ENVPRED_SHARED); skips without it."""
    folder = Path(os.environ.get("ENVPRED_SHARED", REPOSITORY.parent / "shared"))
    if not (folder / "kitti").is_dir():
        if os.environ.get("CI"):
            pytest.fail(f"{folder} is not there, and CI must not skip what needs it")
        pytest.skip(f"real drives and reference arrays are not at {folder}; set ENVPRED_SHARED to where they are")
    return folder


@pytest.fixture(scope="session")
def shared() -> Path:
    """See `shared_folder`."""
    return shared_folder()


@pytest.fixture(scope="session")
def kitti(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """KITTI raw's layout with the real drives 0005 and 0013 (or the folder $ENVPRED_KITTI that already holds them)."""
    if "ENVPRED_KITTI" in os.environ:
        return Path(os.environ["ENVPRED_KITTI"])
    root = tmp_path_factory.mktemp("kitti")
    subprocess.run([sys.executable, shared / "kitti" / "unpack.py", root], check=True, stdout=subprocess.DEVNULL)
    return root
