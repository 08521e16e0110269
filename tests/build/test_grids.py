"""Building a store: what is mapped, what is skipped, and what goes wrong drive by drive."""

import inspect
import platform
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from envpred.build import grids as building
from envpred.build import jobs
from envpred.build.grids import build
from envpred.drives import find_drives
from envpred.drives.drive import Drive
from envpred.errors import UserError
from envpred.mapping import evidence, ground, label_grid
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.store import Store
from tests.build import builds
from tests.drives.synthetic import write_drive

pytestmark = pytest.mark.usefixtures("no_processes")

NAMES = [f"2011_09_26_drive_{number}_sync" for number in ("0001", "0002", "0003")]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    write_drive(root, "0001", frames=12)
    write_drive(root, "0002", frames=9, seed=1, missing_scans={4})
    write_drive(root, "0003", frames=7, seed=2)
    return root


@pytest.fixture(scope="module")
def built(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("built") / "grids"
    result = builds.run(source, store, "--workers", "1")
    assert result.returncode == 0, result.stderr
    return store


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "grids"))


@pytest.fixture
def broken(source: Path, tmp_path: Path) -> Path:
    """The source, with a scan of drive 0002 cut short; what is not touched is linked."""
    root = tmp_path / "broken"
    shutil.copytree(source, root, copy_function=lambda a, b: Path(b).symlink_to(a))
    scan = root / "2011_09_26" / NAMES[1] / "velodyne_points" / "data" / "0000000006.bin"
    data = scan.read_bytes()
    scan.unlink()
    scan.write_bytes(data[:-5])
    return root


def test_store_holds_what_the_mapping_makes(source: Path, built: Path) -> None:
    assert builds.all_valid(built) == NAMES
    for drive in find_drives(source):
        stored, spec = Store(built).drives[drive.name], GridSpec()
        assert stored.frames == drive.frames
        assert stored.stretches == drive.stretches()
        labels, centre_cell = stored.array("label"), stored.array("centre_cell")
        np.testing.assert_array_equal(stored.array("pose"), drive.poses)
        np.testing.assert_array_equal(centre_cell, spec.cell_of(drive.poses[:, :3, 3], stored.origin))
        assert set(np.unique(labels)) == {0, 1, 2, 3}
        for first, length in stored.stretches:  # evidence starts anew after a gap
            cut = slice(first, first + length)
            expected = evidence.accumulate(labels[cut], centre_cell[cut])
            np.testing.assert_allclose(stored.array("evidence")[cut], expected, atol=1e-3)


def test_gap_is_a_gap(built: Path) -> None:
    drive = Store(built).drives[NAMES[1]]
    assert drive.frames == [0, 1, 2, 3, 5, 6, 7, 8]
    assert drive.stretches == [(0, 4), (4, 4)]
    np.testing.assert_allclose(drive.array("time"), 0.1 * np.array(drive.frames), atol=1e-5)


def test_one_and_two_workers_give_the_same_bytes(source: Path, built: Path, tmp_path: Path) -> None:
    result = builds.run(source, tmp_path / "grids", "--workers", "2")
    assert result.returncode == 0, result.stderr
    assert builds.content(tmp_path / "grids") == builds.content(built)


def test_user_sees_what_happens(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    result = builds.run(source, store, "--workers", "1", "--drives", f"[{NAMES[0]}]")
    first, last = builds.lines(result.stderr)[0], builds.lines(result.stderr)[-1]
    assert first == f"1 drive to map, 0 of 1 in {store} already"
    assert last.startswith(f"1 drive, 12 frames mapped into {store} in ")
    assert "12/12" in result.stderr
    assert "frame/s" in result.stderr
    again = builds.run(source, store, "--drives", f"[{NAMES[0]}]")
    assert again.stderr == f"nothing to do: {store} holds 1 drive of {source}\n"
    assert (again.returncode, again.stdout) == (0, "")


def test_finished_drives_are_skipped(source: Path, copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.rmtree(copy / NAMES[1])
    times = {file: file.stat().st_mtime_ns for file in copy.rglob("*.npy")}
    build(source, copy, workers=1)
    assert {file: file.stat().st_mtime_ns for file in times} == times
    assert builds.all_valid(copy) == NAMES
    monkeypatch.setattr(jobs, "in_processes", lambda *_: pytest.fail("something was mapped"))
    build(source, copy, workers=1)


def test_a_drive_without_its_manifest_is_left_to_the_user(source: Path, built: Path, copy: Path) -> None:
    (copy / NAMES[2] / "manifest.json").unlink()
    with pytest.raises(UserError, match=rf"{NAMES[2]}: has no manifest.json, .* move it away, or give"):
        build(source, copy, workers=1)
    (copy / NAMES[2]).rename(copy.parent / "away")
    build(source, copy, workers=1)
    assert builds.content(copy) == builds.content(built)


def test_other_parameters_are_refused_without_force(source: Path, copy: Path) -> None:
    before = builds.content(copy)
    result = builds.run(source, copy, "--sensor", "paper", "--grid.cells", "64")
    assert result.returncode == 1
    (line,) = builds.lines(result.stderr)
    assert "grid.cells 128 there, 64 asked, sensor calibration there, paper asked" in line
    assert "--force" in line
    assert builds.content(copy) == before


def test_force_keeps_the_old_drive_until_the_new_is_complete(broken: Path, built: Path, copy: Path) -> None:
    parameters = MappingParameters(sensor="paper")
    with pytest.raises(UserError, match="1 of 3 drives failed"):
        build(broken, copy, parameters, workers=1, force=True)
    builds.all_valid(copy)
    kept = {name: data for name, data in builds.content(copy).items() if name.startswith(NAMES[1])}
    assert kept == {name: data for name, data in builds.content(built).items() if name.startswith(NAMES[1])}
    keys = {name: drive.manifest["groups"]["mapping"] for name, drive in Store(copy).drives.items()}
    assert keys[NAMES[0]] == keys[NAMES[2]] != keys[NAMES[1]]


def test_forced_build_that_failed_goes_on_without_force(source: Path, broken: Path, copy: Path) -> None:
    parameters = MappingParameters(sensor="paper")
    with pytest.raises(UserError):
        build(broken, copy, parameters, workers=1, force=True)
    times = {file: file.stat().st_mtime_ns for file in (copy / NAMES[0]).iterdir()}
    build(source, copy, parameters, workers=1)
    assert len({drive.manifest["groups"]["mapping"] for drive in Store(copy).drives.values()}) == 1
    assert {file: file.stat().st_mtime_ns for file in times} == times


def test_bad_drive_does_not_stop_the_others(broken: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    result = builds.run(broken, store, "--workers", "1")
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    bad, summary = builds.lines(result.stderr)[-2:]
    assert bad.startswith("envpred: ")
    assert f"{NAMES[1]}/velodyne_points/data/0000000006.bin: " in bad
    assert summary == "1 of 3 drives failed; the others are done"
    assert builds.all_valid(store) == [NAMES[0], NAMES[2]]
    assert builds.parts(store) == []


def test_drive_that_cannot_be_opened_does_not_stop_the_others(source: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(source, tmp_path / "drives"))
    (root / "2011_09_26" / NAMES[0] / "oxts" / "data" / "0000000003.txt").write_text("1 2 3")
    shutil.rmtree(root / "2011_09_26" / NAMES[2] / "velodyne_points" / "data")
    (root / "2011_09_26" / NAMES[2] / "velodyne_points" / "data").mkdir()
    with pytest.raises(UserError) as failure:
        build(root, tmp_path / "grids", workers=1)
    packet, empty, summary = str(failure.value).splitlines()
    assert "0000000003.txt: an OXTS packet is a line of 30 numbers, this one has 3 fields" in packet
    assert f"{NAMES[2]}: no frame has both a scan and a pose" in empty
    assert summary.startswith("2 of 3 drives failed")
    assert builds.all_valid(tmp_path / "grids") == [NAMES[1]]


def test_drive_that_is_not_there_is_named(source: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=f"no drive named 0009 in the source; it has {', '.join(NAMES)}"):
        build(source, tmp_path / "grids", drives=["0009"])
    assert not (tmp_path / "grids").exists()


@pytest.mark.parametrize("workers", [0, -1])
def test_number_of_workers_is_checked(source: Path, tmp_path: Path, workers: int) -> None:
    with pytest.raises(UserError, match=f"--workers {workers}: give at least 1"):
        build(source, tmp_path / "grids", workers=workers)


def test_compiling_ahead_leaves_nothing_to_compile(source: Path, tmp_path: Path) -> None:
    """The call that compiles must have the argument types of the mapping, or every worker compiles again."""
    building._compile(MappingParameters(), 160)
    dispatchers = [
        function
        for module in (ground, label_grid, evidence)
        for _, function in inspect.getmembers(module, lambda member: hasattr(member, "signatures"))
    ]
    before = [list(dispatcher.signatures) for dispatcher in dispatchers]
    assert any(before)
    drive = next(drive for drive in find_drives(source) if drive.name == NAMES[2])
    keys = {"mapping": Store(tmp_path).claim("mapping", {}), "context": "c"}
    building.map_drive(drive, tmp_path, MappingParameters(), keys, 160)
    assert [list(dispatcher.signatures) for dispatcher in dispatchers] == before


def mount(folder: Path, *options: str) -> None:
    """Mount a small file system, or skip where that is not allowed."""
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["mount", *options, str(folder)], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"a full or read-only disk needs a file system of its own, and mount says: {done.stderr.strip()}")


def test_full_disk_is_one_line_and_the_next_run_goes_on(source: Path, built: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    mount(disk, "-t", "tmpfs", "-o", "size=800k", "tmpfs")  # drive 0002 fits, 0001 before and 0003 after it do not
    try:
        result = builds.run(source, disk / "grids", "--workers", "1")
        assert result.returncode == 1
        assert "Traceback" not in result.stderr
        failed = [line for line in builds.lines(result.stderr) if "No space left on device" in line]
        assert [name for name in NAMES if any(name in line for line in failed)] == [NAMES[0], NAMES[2]]
        assert builds.all_valid(disk / "grids") == [NAMES[1]]
        assert builds.parts(disk / "grids") == []
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        assert builds.run(source, disk / "grids", "--workers", "1").returncode == 0
        assert builds.content(disk / "grids") == builds.content(built)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("claimed", [False, True])
def test_read_only_store_is_one_line(source: Path, tmp_path: Path, claimed: bool) -> None:
    disk = tmp_path / "disk"
    mount(disk, "-t", "tmpfs", "-o", "size=1m", "tmpfs")
    try:
        if claimed:
            Store(disk / "grids").claim("mapping", MappingParameters().as_dict())
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        result = builds.run(source, disk / "grids", "--workers", "1", "--drives", f"[{NAMES[2]}]")
        assert result.returncode == 1
        assert "Traceback" not in result.stderr
        (line,) = [line for line in builds.lines(result.stderr) if line.startswith("envpred: ")]
        assert "Read-only file system" in line
        assert str(disk / "grids") in line
    finally:
        subprocess.run(["umount", str(disk)], check=True)


class Faulty(Drive):
    """A drive with a fault of the program, not of the user."""

    name = "faulty"
    frames = [0]  # noqa: RUF012

    scan = pose = time = sensor_to_body = None  # type: ignore[assignment]


def test_fault_of_the_program_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, "find_drives", lambda _: [Faulty()])
    with pytest.raises(TypeError):
        build(tmp_path, tmp_path / "grids", workers=1)


def test_a_store_that_a_worker_cannot_see_is_named(tmp_path: Path) -> None:
    parameters, lacking = MappingParameters(), {"faulty": {"mapping": "key"}}
    line = building._attempt(
        Faulty(), lambda: None, store=tmp_path / "far", parameters=parameters, lacking=lacking, context=None
    )
    assert line == f"{tmp_path / 'far'}: not to be seen from {platform.node()}; give a folder that all workers share"
