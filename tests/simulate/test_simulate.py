"""Whole simulated drives: other people's readers open them, their parts agree, and same seeds give same bits."""

import hashlib
from pathlib import Path

import numpy as np
import pykitti
import pytest

from envpred.build.grids import map_drive
from envpred.build.moving import add_moving
from envpred.drives import find_drives
from envpred.drives.kitti import KittiDrive
from envpred.mapping.boxes import MOVES, STANDS
from envpred.mapping.geometry import FREE, GridSpec
from envpred.mapping.ground import MarkovRandomField
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.mapper import MappingParameters
from envpred.simulate import classes
from envpred.simulate.ego import SENSOR_HEIGHT
from envpred.simulate.realism import figures, realism
from envpred.simulate.run import simulate
from envpred.simulate.writer import DATE, TRUE_POSES, drive_name
from envpred.store import Store, StoredDrive

DRIVES, FRAMES = 3, 8


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[KittiDrive]:
    out = tmp_path_factory.mktemp("simulated")
    simulate(out, drives=DRIVES, frames=FRAMES, seed=11, workers=1)
    found = find_drives(out)
    assert [d.name for d in found] == [drive_name(k + 1) for k in range(DRIVES)]
    return [d for d in found if isinstance(d, KittiDrive)]


def words_of(drive: KittiDrive, frame: int) -> np.ndarray:
    return np.fromfile(drive.folder / "labels" / f"{frame:010d}.label", np.uint32)


def true_poses(drive: KittiDrive) -> np.ndarray:
    """(T, 4, 4) sensor to world at every scan, where OXTS has those of the last fix before it."""
    rows = np.loadtxt(drive.folder / TRUE_POSES).reshape(-1, 3, 4)
    return np.concatenate([rows, np.tile([[[0, 0, 0, 1.0]]], (len(rows), 1, 1))], axis=1)


def digest(root: Path) -> dict[str, str]:
    return {
        str(f.relative_to(root)): hashlib.sha256(f.read_bytes()).hexdigest()
        for f in sorted(root.rglob("*"))
        if f.is_file()
    }


def test_pykitti_opens_a_drive(drives: list[KittiDrive]) -> None:
    data = pykitti.raw(str(drives[0].folder.parents[1]), DATE, "0001")
    assert len(data.oxts) == len(data.timestamps) == len(data.velo_files) == FRAMES
    assert data.get_velo(0).shape[1] == 4
    np.testing.assert_allclose(data.calib.T_velo_imu[:3, 3], [-0.81, 0.32, -0.80])
    # A point straight ahead of the sensor falls into the middle of the left camera's picture, 8 cm lower.
    pixel = data.calib.P_rect_20 @ data.calib.T_cam0_velo @ [20.0, 0, 0, 1]
    assert pixel[0] / pixel[2] == pytest.approx(621, abs=5)
    assert pixel[1] / pixel[2] == pytest.approx(187.5 - 720 * 0.08 / 19.7, abs=0.5)
    assert (data.timestamps[1] - data.timestamps[0]).total_seconds() == pytest.approx(0.1, abs=0.007)


def test_the_readers_agree_on_frames_and_times(drives: list[KittiDrive]) -> None:
    for drive in drives:
        assert drive.frames == list(range(FRAMES))
        assert drive.time(FRAMES - 1) == pytest.approx(0.1 * (FRAMES - 1))
        parts = [
            (drive.folder / "velodyne_points" / f"timestamps{part}.txt").read_text() for part in ("_start", "", "_end")
        ]
        start, middle, end = (np.array(part.split("\n")[:FRAMES], "datetime64[ns]") for part in parts)
        np.testing.assert_array_equal(middle - start, np.timedelta64(50_000_000, "ns"))
        np.testing.assert_array_equal(end[:-1], start[1:])
        np.testing.assert_array_equal(end - middle, np.timedelta64(50_000_000, "ns"))


def test_velocity_acceleration_and_rate_belong_to_the_poses(drives: list[KittiDrive]) -> None:
    for drive in drives:
        packets = np.array([np.loadtxt(f) for f in sorted((drive.folder / "oxts" / "data").iterdir())])
        assert packets.shape == (FRAMES, 30)
        poses = drive.poses
        places = poses[:, :3, 3]
        stamps = (drive.folder / "oxts" / "timestamps.txt").read_text().split("\n")[:FRAMES]
        times = (np.array(stamps, "datetime64[ns]") - np.datetime64(stamps[0], "ns")) / np.timedelta64(1, "s")
        passed = times[2:] - times[:-2]
        assert not np.allclose(passed, 0.2, atol=1e-3)
        central = (places[2:] - places[:-2]) / passed[:, None]
        np.testing.assert_allclose(central[:, 0], packets[1:-1, 7], atol=0.02)  # ve; fixes come unevenly
        np.testing.assert_allclose(central[:, 1], packets[1:-1, 6], atol=0.02)  # vn
        np.testing.assert_allclose(central[:, 2], packets[1:-1, 10], atol=2e-3)  # vu
        yaw = np.unwrap(packets[:, 5])
        np.testing.assert_allclose(packets[:, 8], np.cos(yaw) * packets[:, 7] + np.sin(yaw) * packets[:, 6], atol=1e-6)
        np.testing.assert_allclose(packets[:, 9], np.cos(yaw) * packets[:, 6] - np.sin(yaw) * packets[:, 7], atol=1e-6)
        np.testing.assert_allclose((yaw[2:] - yaw[:-2]) / passed, packets[1:-1, 22], atol=6e-3)  # wu
        # Force in the body frame turned into the level frame is the force there; at rest it is gravity.
        for row, pose in zip(packets, poses, strict=True):
            c, s = np.cos(row[5]), np.sin(row[5])
            level = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ pose[:3, :3] @ row[11:14]
            np.testing.assert_allclose(level, row[14:17], atol=1e-5)
        assert packets[:, 16].mean() == pytest.approx(9.81, abs=0.5)


def test_the_sensor_rides_above_the_road(drives: list[KittiDrive]) -> None:
    for drive in drives:
        for k in (0, FRAMES - 1):
            points, words = drive.scan(k), words_of(drive, k)
            near = (np.hypot(*points[:, :2].T) < 6) & (classes.semantic(words) == classes.ROAD)
            assert np.median(points[near, 2]) == pytest.approx(-SENSOR_HEIGHT, abs=0.12)


def test_every_point_has_a_label_we_know(drives: list[KittiDrive]) -> None:
    seen = set()
    for drive in drives:
        for k in drive.frames:
            points, words = drive.scan(k), words_of(drive, k)
            assert len(points) == len(words)
            assert 95_000 < len(points) < 126_000
            seen |= set(classes.semantic(words).tolist())
    assert seen <= set(classes.COLOURS)
    assert seen >= {
        classes.ROAD,
        classes.SIDEWALK,
        classes.TERRAIN,
        classes.BUILDING,
        classes.VEGETATION,
        classes.TRUNK,
        classes.POLE,
        classes.CAR,
    }
    assert seen & set(classes.MOVING)


def test_the_points_of_an_object_lie_in_its_box(drives: list[KittiDrive]) -> None:
    """Cars, people, cyclists, still or moving: nearly all their points lie in a box that holds few others' points."""
    objects = [classes.CAR, classes.PERSON, classes.BICYCLIST, classes.TRUCK, classes.BICYCLE, *classes.MOVING]
    for drive in drives:
        boxes = drive.tracklets()
        for k in (0, FRAMES // 2, FRAMES - 1):
            points, words = drive.scan(k), words_of(drive, k)
            inside = np.zeros(len(points), bool)
            for box in boxes:
                if k in box.frames:
                    inside |= box.contains(k, points, margin=0.12)
            is_object = np.isin(classes.semantic(words), objects)
            assert is_object.sum() > 20
            assert inside[is_object].mean() > 0.985
            above = inside & ~is_object & (points[:, 2] > -1.2)
            assert above.sum() < 0.05 * is_object.sum()


def test_boxes_of_parked_cars_stand_still_in_the_world(drives: list[KittiDrive]) -> None:
    for drive in drives:
        sensor = true_poses(drive)
        for box in drive.tracklets():
            places = np.array([(sensor[box.first + j] @ [*p[:3], 1])[:3] for j, p in enumerate(box.poses)])
            assert np.hypot(*np.diff(places[:, :2], axis=0).T).max(initial=0) < 2.0  # nobody faster than 20 m/s
            if box.kind == "Misc":  # parked bicycles
                np.testing.assert_allclose(places - places[0], 0, atol=2e-3)


def test_moving_and_standing_classes_follow_the_boxes_speed(drives: list[KittiDrive]) -> None:
    """An object's class is one and its moving twin; cars of the moving class have boxes that move, the others not."""
    judged = 0
    for drive in drives:
        sensor = true_poses(drive)
        boxes = [b for b in drive.tracklets() if b.kind == "Car"]
        for k in (2, 5):
            points, words = drive.scan(k), words_of(drive, k)
            for number in np.unique(classes.instance(words))[1:]:
                mine = classes.instance(words) == number
                kinds = np.unique(classes.semantic(words[mine]))
                assert len(kinds) == 1
                if mine.sum() < 30 or kinds[0] not in (classes.CAR, classes.MOVING_CAR):
                    continue
                held = [b for b in boxes if b.first < k < b.first + len(b.poses) - 1]
                box = max(held, key=lambda b: b.contains(k, points[mine], 0.1).sum())
                ends = [(sensor[j] @ [*box.poses[j - box.first][:3], 1])[:2] for j in (k - 1, k + 1)]
                speed = np.hypot(*(ends[1] - ends[0])) / 0.2
                assert (speed > 0.3) == (kinds[0] == classes.MOVING_CAR)
                judged += 1
    assert judged > 20


def test_free_cells_hold_no_object(drives: list[KittiDrive]) -> None:
    spec = GridSpec()
    for drive in drives:
        origin = spec.lattice_origin(drive.poses[:, :3, 3])
        centre = spec.cell_of(drive.poses[0, :3, 3], origin)
        sensor = drive.poses[0] @ drive.sensor_to_body()
        points, words = drive.scan(0), words_of(drive, 0)
        obstacle = MarkovRandomField().obstacles(points, spec.reach)
        grid = RayCasting().label(points, obstacle, sensor, centre, origin, spec)
        thing = ~np.isin(classes.semantic(words), (*classes.GROUND, classes.VEGETATION)) & (points[:, 2] < 0.2)
        world = points[thing, :3] @ sensor[:3, :3].T + sensor[:3, 3]
        cells = spec.cell_of(world, origin) - centre + spec.half
        cells = np.unique(cells[((cells >= 0) & (cells < spec.cells)).all(axis=1)], axis=0)
        assert (grid[cells[:, 0], cells[:, 1]] == FREE).sum() < 0.005 * (grid == FREE).sum()
        assert (grid == FREE).mean() > 0.05


def test_cells_move_by_the_boxes_where_points_move_by_their_class(drives: list[KittiDrive], tmp_path: Path) -> None:
    """Boxes know nothing of the points' classes, nor these of the speed that is asked of boxes."""
    store, found = Store(tmp_path), {MOVES: 0, STANDS: 0}
    parameters = MappingParameters(GridSpec(256, 0.5))  # traffic is not always near
    keys = {"mapping": store.claim("mapping", parameters.as_dict())}
    for drive in drives:
        map_drive(drive, tmp_path, parameters, keys)
        add_moving(drive, tmp_path, store.claim("moving", {}))
        stored = StoredDrive(tmp_path / drive.name)
        sensor = drive.poses @ drive.sensor_to_body()
        for k in (0, FRAMES - 1):
            points, words = drive.scan(k), classes.semantic(words_of(drive, k))
            world = points[:, :3] @ sensor[k, :3, :3].T + sensor[k, :3, 3]
            cells = stored.grid.cell_of(world, stored.origin) - stored.array("centre_cell")[k] + stored.grid.half
            within = ((cells >= 0) & (cells < stored.grid.cells)).all(axis=1)
            codes = stored.array("moving")[k][tuple(cells[within].T)]
            for code, kinds in {MOVES: classes.MOVING, STANDS: (classes.CAR, classes.BICYCLE)}.items():
                mine = codes[np.isin(words[within], kinds)]
                # One point may lie between an object's edge and what is behind it.
                assert (mine == code).sum() >= 0.97 * len(mine) - 1, (drive.name, k, code, np.bincount(mine))
                found[code] += len(mine)
    assert min(found.values()) > 100, found


@pytest.mark.slow
def test_same_seed_same_bits_however_many_processes_and_drives(drives: list[KittiDrive], tmp_path: Path) -> None:
    simulate(tmp_path / "again", drives=2, frames=FRAMES, seed=11, workers=2)
    for k in (1, 2):
        assert digest(tmp_path / "again" / DATE / drive_name(k)) == digest(drives[k - 1].folder)
    assert not list((tmp_path / "again").rglob(".*.unfinished"))


def test_another_seed_is_another_ego_elsewhere(drives: list[KittiDrive], tmp_path: Path) -> None:
    simulate(tmp_path / "other", drives=1, frames=2, seed=12, workers=1)
    other = find_drives(tmp_path / "other")[0]
    paths = [
        np.loadtxt(d.folder / "oxts" / "data" / "0000000000.txt")[:2]
        for d in [*drives, other]
        if isinstance(d, KittiDrive)
    ]
    gaps = np.abs(np.subtract.outer(*[np.array(paths)[:, 0]] * 2)) + np.eye(len(paths))
    assert gaps.min() > 1e-7


def test_figures_of_simulated_drives_are_those_of_real_ones(drives: list[KittiDrive]) -> None:
    """Drives beside themselves: none lies outside, and the distance is none."""
    day = drives[0].folder.parent
    lines = realism(day, day).splitlines()
    got = figures(drives[0])
    assert len(lines) == 1 + len(got) + DRIVES
    assert sum(got[f"share {name}"] for name in ("unknown", "occupied", "free", "ego")) == pytest.approx(1)
    assert np.isnan(got["static, MSE x 1e-3, 0.1 s"])  # too short for a window
    assert 0.02 < got["share occupied"] < 0.2
    row = next(line for line in lines if line.startswith("points a scan"))
    assert float(row.split()[-1]) == 0
    assert any("*" in line for line in lines)  # of three drives the least lies below what 5 % of them lie below


def test_the_figures_of_the_real_drives_are_the_published_ones(kitti: Path) -> None:
    got = figures(KittiDrive(kitti / "2011_09_26" / "2011_09_26_drive_0013_sync"))
    assert got["points a scan"] == pytest.approx(122_037, rel=1e-3)
    assert got["left after ground removal"] == pytest.approx(35_009, rel=0.02)
    shares = [got[f"share {name}"] for name in ("unknown", "occupied", "free", "ego")]
    assert shares == pytest.approx((0.4103, 0.0699, 0.5155, 0.0043), abs=0.01)
    static = [got[f"static, MSE x 1e-3, {seconds} s"] for seconds in ("0.1", "0.5", "1.0", "1.5")]
    assert static == pytest.approx((32.43, 52.92, 62.62, 68.64), rel=0.02)
