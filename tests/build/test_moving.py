"""What moves by boxes of tracked objects: in a store beside the grids, by where the boxes are in the world."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from envpred.build import moving
from envpred.build.grids import build
from envpred.cli.commands import grids
from envpred.cli.own import parsed
from envpred.drives import find_drives
from envpred.drives.tracklets import HIDDEN, TRACKLETS, VISIBLE, Tracklet
from envpred.errors import UserError
from envpred.mapping.boxes import MOVES, NO_BOX, STANDS
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.simulate.tracklets import write
from envpred.store import Store, StoredDrive
from tests.build import builds
from tests.drives.synthetic import PERIOD, write_drive
from tests.remedies import remedy

pytestmark = pytest.mark.usefixtures("no_processes")

FRAMES = 12
PARAMETERS = MappingParameters(GridSpec(cells=64))
# Places (x, y) in the world, m, and headings, by the time in seconds; the ego drives north-east from (0, 0).
ACTORS: dict[str, Callable[[float], tuple[float, float, float]]] = {
    "parked": lambda t: (6.0, -4.0, 0.3),
    "driven": lambda t: (2.0, 5.0 + 4 * t, np.pi / 2),
    "creeping": lambda t: (-5.0 + 0.4 * t, 0.0, 0.0),
    "turning": lambda t: (-4 + 4 * np.cos(t), -6 + 4 * np.sin(t), t + np.pi / 2),
    "far": lambda t: (60.0 + 9 * t, 0.0, 0.0),
    "hidden": lambda t: (-8.0 + 5 * t, 8.0, 0.0),
}
SIZE = (2.0, 1.0, 1.5)


def write_tracked(root: Path, number: str = "0001") -> Path:
    """A drive of an ego that turns, with a box for each of the ACTORS; of the last one only the first frame is seen."""
    folder = write_drive(root, number, frames=FRAMES, azimuths=90, speed=6, heading=0.7, weave=0.5)
    (drive,) = (drive for drive in find_drives(root) if drive.name == folder.name)
    boxes = []
    for name, way in ACTORS.items():
        poses = []
        for pose, time in zip(drive.poses @ drive.sensor_to_body(), PERIOD * np.arange(FRAMES), strict=True):
            x, y, heading = way(time)
            forward, left, up = (np.linalg.inv(pose) @ [x, y, -1.0, 1])[:3].tolist()
            turn = float(np.arctan2(pose[1, 0], pose[0, 0]))
            poses.append((forward, left, up, (heading - turn + np.pi) % (2 * np.pi) - np.pi))
        seen = [VISIBLE] + [HIDDEN if name == "hidden" else VISIBLE] * (FRAMES - 1)
        boxes.append(Tracklet("Car", SIZE, 0, poses, seen))
    write(folder / TRACKLETS, boxes)
    return folder


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with boxes and one without."""
    root = tmp_path_factory.mktemp("drives")
    write_tracked(root)
    write_drive(root, "0002", frames=4, azimuths=90)
    return root


def codes_at(stored: StoredDrive, t: int, x: float, y: float) -> int:
    """The code of the cell at a place (m) in the world."""
    cell = stored.grid.cell_of(np.array([x, y]), stored.origin) - stored.array("centre_cell")[t] + stored.grid.half
    return int(stored.array("moving")[t][tuple(cell)])


def test_what_stands_and_what_moves_by_hand(source: Path, tmp_path: Path) -> None:
    build(source, tmp_path / "grids", PARAMETERS)
    drives = Store(tmp_path / "grids").drives
    stored = drives["2011_09_26_drive_0001_sync"]
    assert not drives["2011_09_26_drive_0002_sync"].has("moving")
    assert stored.array("moving").dtype == np.uint8
    for t, time in enumerate(PERIOD * np.arange(FRAMES)):
        codes = {name: codes_at(stored, t, *way(time)[:2]) for name, way in ACTORS.items() if name != "far"}
        hidden = MOVES if t == 0 else NO_BOX
        assert codes == {"parked": STANDS, "driven": MOVES, "creeping": STANDS, "turning": MOVES, "hidden": hidden}
        # 2 m by 1 m, made half a cell larger on all sides: 7 by 4 cells of the third of a metre, by and large.
        counts = np.bincount(stored.array("moving")[t].ravel(), minlength=3)
        assert 2 * 22 <= counts[STANDS] <= 2 * 34
        assert (2 + (t == 0)) * 22 <= counts[MOVES] <= (2 + (t == 0)) * 34
        # A box that turns is longer where it looks to.
        x, y, heading = ACTORS["turning"](time)
        ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        for sign in (-1, 1):
            assert codes_at(stored, t, *((x, y) + sign * 0.9 * ahead)) == MOVES
            assert codes_at(stored, t, *((x, y) + sign * 1.0 * left)) == NO_BOX
    stored.verify()


def test_it_comes_in_the_same_run_or_later_alike(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at_once, later = tmp_path / "at_once", tmp_path / "later"
    build(source, at_once, PARAMETERS)
    off = parsed("grids", grids, [f"--store={later}", "--tracklets=false"])
    build(source, later, PARAMETERS, tracklets=off["tracklets"])
    name = "2011_09_26_drive_0001_sync"
    assert "moving" not in Store(later).parameters("moving")
    before = {file: file.stat().st_mtime_ns for file in later.rglob("*.npy")}
    with pytest.raises(UserError, match="no array 'moving'") as refusal:
        Store(later).drives[name].array("moving")
    (command,) = remedy(refusal.value)
    given = parsed("grids", grids, [str(source) if word == "DRIVES" else word for word in command[1:]])
    build(given["source"], given["store"], PARAMETERS)
    assert {file: file.stat().st_mtime_ns for file in before} == before
    first, second = (Store(store).drives[name].array("moving") for store in (at_once, later))
    np.testing.assert_array_equal(first, second)
    builds.all_valid(later)
    capsys.readouterr()
    build(source, later, PARAMETERS)
    assert "nothing to do" in capsys.readouterr().err


def test_where_boxes_overlap_what_moves_is_told(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "2011_09_26_drive_0002_sync"
    build(source, tmp_path, PARAMETERS, drives=[name])
    (drive,) = (drive for drive in find_drives(source) if drive.name == name)
    ego = drive.poses[:, 0, 3] - drive.poses[0, 0, 3]  # heading east
    ways = [[(5.0 - x, 4.0, -1.0, 0.0) for x in ego], [(5.0 - x + k, 4.0, -1.0, 0.0) for k, x in enumerate(ego)]]
    for order in (1, -1):
        boxes = [Tracklet("Car", SIZE, 0, way, [VISIBLE] * 4) for way in ways[::order]]
        monkeypatch.setattr(type(drive), "tracklets", lambda _, boxes=boxes: boxes)
        moving.add_moving(drive, tmp_path, Store(tmp_path).claim("moving", {}))
        first, *_, last = StoredDrive(tmp_path / name).array("moving")
        assert set(np.unique(first)) == {NO_BOX, MOVES}
        assert set(np.unique(last)) == {NO_BOX, STANDS, MOVES}


def test_other_rules_are_stale(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build(source, tmp_path / "grids", PARAMETERS)
    name = "2011_09_26_drive_0001_sync"
    monkeypatch.setitem(moving.PARAMETERS, "slowest", 0.1)
    with pytest.raises(UserError, match=r"its moving grids were built with other parameters \(slowest 0.5 there"):
        build(source, tmp_path / "grids", PARAMETERS)
    store = Store(tmp_path / "grids")
    store.claim("moving", {"slowest": 0.1}, force=True)
    with pytest.raises(UserError, match=r"the moving grids of .* were built with other parameters"):
        store.check([name], ["moving"])


def test_damaged_boxes_leave_the_grids(tmp_path: Path) -> None:
    folder = write_tracked(tmp_path / "drives")
    (folder / TRACKLETS).write_text("<a>")
    with pytest.raises(UserError, match=r"tracklet_labels.xml: cannot be read as XML .*\n1 of 1 drives failed"):
        build(tmp_path / "drives", tmp_path / "grids", PARAMETERS)
    stored = Store(tmp_path / "grids").drives[folder.name]
    stored.verify()
    assert not stored.has("moving")
    (folder / TRACKLETS).unlink()
    build(tmp_path / "drives", tmp_path / "grids", PARAMETERS)  # nothing is lacking then
