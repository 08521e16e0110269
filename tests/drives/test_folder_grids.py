"""Grids and estimated poses that an `envpred.yaml` asks for."""

import shutil
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest

from envpred.build import jobs
from envpred.build.grids import build
from envpred.build.stated import as_stated
from envpred.drives import estimated, find_drives, one_drive
from envpred.drives import folder as folders
from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.store import Store
from tests.drives import own
from tests.drives.conftest import FRAMES
from tests.remedies import installs, remedy


def test_grid_and_context_of_the_settings_are_built(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    own.say(folder, grid={"cells": 32, "resolution": 0.5}, context=48)
    build(folder, tmp_path / "grids", workers=1)
    (stored,) = Store(tmp_path / "grids").drives.values()
    assert stored.manifest["lattice"]["resolution"] == 0.5
    assert stored.array("label").shape == (FRAMES, 32, 32)
    assert stored.array("context_label").shape == (FRAMES, 48, 48)
    assert "poses" not in stored.manifest["source"]
    shutil.copytree(folder, tmp_path / "both" / "a")
    shutil.copytree(folder, tmp_path / "both" / "b")
    own.say(tmp_path / "both" / "b", grid={"cells": 64}, context=None)
    with pytest.raises(UserError, match=r"ask for 32 cells of 0\.5 m and 64 cells of 0\.3333 m, and a") as failure:
        build(tmp_path / "both", tmp_path / "two")
    assert remedy(failure.value) == [["--drives"]]
    build(tmp_path / "both", tmp_path / "two", drives=["b"], workers=1)
    assert Store(tmp_path / "two").drives["b"].array("label").shape == (FRAMES, 64, 64)


def test_a_grid_that_the_command_line_gives_is_taken(folder: Path) -> None:
    own.say(folder, grid={"cells": 32}, context=48)
    drives = find_drives(folder)
    given = MappingParameters(GridSpec(64))
    assert as_stated(drives, given, 128) == (given, 128)


def test_poses_are_estimated_and_the_manifest_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recorded: own.Recorded
) -> None:
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    true = np.linalg.inv(recorded.sensor[0]) @ recorded.sensor
    monkeypatch.setattr(folders, "estimate", lambda sweeps, _: (true, np.zeros(len(list(sweeps)))))
    own.say(folder, poses={"format": "kiss-icp"}, grid={"cells": 16})
    told = f"kiss-icp {version('kiss-icp')}"
    np.testing.assert_allclose(one_drive(folder).poses, np.linalg.inv(recorded.body[0]) @ recorded.body, atol=1e-9)
    build(folder, tmp_path / "grids", workers=1)
    (stored,) = Store(tmp_path / "grids").drives.values()
    assert stored.manifest["source"]["poses"] == f"estimated by {told}"
    assert f"mine: nobody measured its poses, which {told} estimated from the scans" in stored.warnings


def test_estimated_poses_are_moved_to_the_stamps(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a metre a scan, known at the middle of each sweep, half a period after its stamp: a quarter metre less."""
    path = np.tile(np.eye(4), (FRAMES, 1, 1))
    path[:, 0, 3] = 0.5 * np.arange(FRAMES)
    monkeypatch.setattr(folders, "estimate", lambda sweeps, period: (path, np.full(len(list(sweeps)), period / 2)))
    own.say(folder, poses={"format": "kiss-icp"})
    np.testing.assert_allclose(one_drive(folder).poses[:, 0, 3], path[:, 0, 3] - 0.25)


@pytest.mark.slow
def test_a_path_is_estimated_from_bent_scans(tmp_path: Path) -> None:
    """Deskewed by its own motion, a path of 48 m ends within a metre of the true one."""
    bent = own.record(60, moves=True)
    how = {"by": "time", "stamp": "start"}
    said = {"poses": {"format": "kiss-icp"}, "deskew": how}
    drive = one_drive(own.write(tmp_path / "mine", bent, ".npy", said, with_time=True))
    np.testing.assert_allclose(
        (np.linalg.inv(drive.poses[0]) @ drive.poses)[-1, :3, 3],
        (np.linalg.inv(bent.body[0]) @ bent.body)[-1, :3, 3],
        atol=1.0,
    )


def test_without_the_extra_it_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(estimated, "version", lacking)
    own.say(folder, poses={"format": "kiss-icp"})
    with pytest.raises(UserError, match="kiss-icp, which is not installed: pip install") as failure:
        find_drives(folder)
    ((command),) = remedy(failure.value)
    assert "kiss-icp" in installs(command)
