"""Drives are safe from the store that is made of them, wherever it is put."""

import shutil
from pathlib import Path

import pytest

from envpred.build.grids import build
from envpred.errors import UserError
from envpred.mapping.mapper import MappingParameters
from envpred.store import Store
from tests.build import builds
from tests.drives.synthetic import write_drive

pytestmark = pytest.mark.usefixtures("no_processes")


@pytest.mark.parametrize(
    ("place", "how"),
    [("base/drives", "is"), ("base/drives/2011_09_26", "lies in"), ("base", "holds"), ("link/grids", "lies in")],
)
def test_a_store_that_is_not_apart_from_the_source_is_refused(tmp_path: Path, place: str, how: str) -> None:
    """Also where it is a store already, into which the drives were unpacked later."""
    source, store = tmp_path / "base" / "drives", tmp_path / place
    (tmp_path / "link").symlink_to(source)
    (source if place.startswith("link") else tmp_path).mkdir(parents=True, exist_ok=True)
    Store(store).claim("mapping", MappingParameters().as_dict())
    folder = write_drive(source, frames=2)
    if how == "is":
        shutil.move(folder, source)  # where the grids of the drive would go
    before = builds.content(tmp_path)
    with pytest.raises(UserError, match=f"--store {store}: {how} the source .* give a folder apart"):
        build(source, store, workers=1)
    assert builds.content(tmp_path) == before


def test_scans_are_safe_from_a_store_that_a_link_leads_to(tmp_path: Path) -> None:
    """The source knows the drive by a link alone, so that the store does not seem to hold it."""
    store, parameters = tmp_path / "grids", MappingParameters(sensor="paper")
    Store(store).claim("mapping", parameters.as_dict())
    folder = write_drive(tmp_path, frames=2)
    shutil.move(folder, store)
    (tmp_path / "2011_09_26" / folder.name).symlink_to(store / folder.name)
    before = builds.content(store)
    with pytest.raises(UserError, match=r"has no manifest\.json"):
        build(tmp_path / "2011_09_26", store, parameters, workers=1)
    assert builds.content(store) == before
