"""Drives whose ego moves on while the sensor turns: what bends, and what the YAML beside them straightens."""

from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.drives import Drive, find_drives
from envpred.drives.folder import FolderDrive
from envpred.simulate import classes
from envpred.simulate.writer import TRUE_POSES

FRAMES = 6


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Drive, Drive]:
    """The same fast drive with scans as they left the sensor, and as KITTI's are, corrected."""
    root = tmp_path_factory.mktemp("swept")
    for name, options in (("swept", ["--swept", "true"]), ("frozen", [])):
        main(["simulate", str(root / name), "--drives=1", f"--frames={FRAMES}", "--seed=4", "--mix=arterial", *options])
    return find_drives(root / "swept")[0], find_drives(root / "frozen")[0]


def standing(drive: Drive, k: int, points: np.ndarray) -> np.ndarray:
    """Points of poles and trunks in the world, by the true pose."""
    folder: Path = drive.folder  # type: ignore[attr-defined]
    words = classes.semantic(np.fromfile(folder / "labels" / f"{k:010d}.label", np.uint32))
    kept = np.isin(words, (classes.POLE, classes.TRUNK))  # thin ones, of no length to hide a shift
    pose = np.loadtxt(folder / TRUE_POSES)[k].reshape(3, 4)
    return np.asarray(points[kept, :3] @ pose[:, :3].T + pose[:, 3])


def spread(points: np.ndarray, other: np.ndarray) -> float:
    """Median distance, seen from above, of points to the nearest of others."""
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(other[:, :2]).query(points[:, :2])[0]))


def test_a_yaml_says_what_swept_drives_are(swept: tuple[Drive, Drive]) -> None:
    ours, theirs = swept
    assert isinstance(ours, FolderDrive)
    assert not isinstance(theirs, FolderDrive)
    assert ours.frames == theirs.frames == list(range(FRAMES))
    assert ours.sensor_height == pytest.approx(theirs.sensor_height, abs=0.01)
    np.testing.assert_allclose(ours.sensor_to_body(), theirs.sensor_to_body(), atol=1e-6)
    speed = np.hypot(*np.diff(ours.poses[:, :2, 3], axis=0).T) / 0.1
    assert speed.min() > 5, "a slow drive shows nothing"
    # Fixes are older than scans, but they say when they were taken: between them the poses are the true ones.
    true = np.loadtxt(ours.folder / TRUE_POSES)[:, [3, 7]]
    sensor = (ours.poses @ ours.sensor_to_body())[:, :2, 3]
    steps = np.linalg.norm(np.diff(sensor, axis=0) - np.diff(true, axis=0), axis=1)
    late = np.linalg.norm(np.diff((theirs.poses @ theirs.sensor_to_body())[:, :2, 3] - true, axis=0), axis=1)
    assert steps[1:].max() < 0.01 < late.max()


def test_what_stands_stands_where_it_is_once_the_sweep_is_straightened(swept: tuple[Drive, Drive]) -> None:
    ours, theirs = swept
    assert isinstance(ours, FolderDrive)
    raw, mended = [], []
    for k in range(1, FRAMES - 1):
        truth = standing(theirs, k, theirs.scan(k))
        raw.append(spread(standing(ours, k, ours.sweep(k).points), truth))
        mended.append(spread(standing(ours, k, ours.scan(k)), truth))
    assert np.mean(mended) < 0.5 * np.mean(raw), (mended, raw)


def test_a_folder_of_one_kind_takes_no_drives_of_the_other(
    swept: tuple[Drive, Drive], capsys: pytest.CaptureFixture[str]
) -> None:
    for drive, options, told in (
        (swept[0], [], "swept True there, False asked"),
        (swept[1], ["--swept", "true"], "swept False there, True asked"),
    ):
        root = str(drive.folder.parents[1])  # type: ignore[attr-defined]
        with pytest.raises(SystemExit):
            main(["simulate", root, "--drives=2", f"--frames={FRAMES}", "--seed=4", "--mix=arterial", *options])
        assert told in capsys.readouterr().err
