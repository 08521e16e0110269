"""The sensor: its geometry, its noise, what it does not see; and the meshes it looks at."""

import numpy as np
import pytest
from embreex.rtcore import EmbreeDevice
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.simulate import classes, furniture, models
from envpred.simulate.clutter import Clutter
from envpred.simulate.lidar import HDL64E, SENSORS, Rings
from envpred.simulate.mesh import Mesh, box, join, mesh
from envpred.simulate.rays import Target
from envpred.simulate.traffic import KINDS

DEVICE = EmbreeDevice()
SENSOR = HDL64E()


def pose_at(x: float = 0.0, y: float = 0.0, z: float = 1.73, yaw: float = 0.0) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def plane(size: float = 300.0) -> Mesh:
    return box((-size, size), (-size, size), (-1.0, 0.0), classes.ROAD, "asphalt")


def rings_of(points: np.ndarray) -> np.ndarray:
    """The number of the beam of every point of a scan whose beams all return something, from KITTI's order."""
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    return np.concatenate([[0], np.cumsum(np.diff(azimuth) < -3)])


def test_beams_leave_where_those_of_kittis_scans_do() -> None:
    degrees = np.degrees(SENSOR.elevation)
    assert len(degrees) == 64
    np.testing.assert_allclose(np.diff(degrees[:32]), -0.342, atol=1e-3)
    np.testing.assert_allclose(np.diff(degrees[32:]), -0.513, atol=1e-3)
    np.testing.assert_allclose(np.degrees(np.diff(SENSOR.azimuth)), 0.1673, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(SENSOR.directions, axis=1), 1, atol=1e-6)
    # Seen from inside a round tower all beams return something, and each ring's line through its points says its place.
    angle = np.linspace(0, 2 * np.pi, 721)
    tower = mesh(
        [(r * np.cos(a), r * np.sin(a), z) for a in angle for r, z in ((5.0, -30.0), (30.0, 30.0))],
        [f for k in range(720) for f in ((2 * k, 2 * k + 1, 2 * k + 2), (2 * k + 1, 2 * k + 3, 2 * k + 2))],
        classes.BUILDING,
        "plaster",
    )
    near = join([tower, box((8.0, 9.0), (-3, 3), (-9, 9), classes.BUILDING, "plaster")])  # another range for each ring
    points, _ = HDL64E(noise=0.0).scan(Target(near, DEVICE), None, pose_at(z=0.0), np.random.default_rng(0))
    rings = rings_of(points)
    assert rings[-1] == 63
    for ring, wanted in ((0, (1.94, 0.204)), (31, (-8.66, 0.204)), (32, (-9.06, 0.121)), (50, (-18.29, 0.121))):
        mine = points[rings == ring].astype(float)
        slope, lift = np.polyfit(np.hypot(mine[:, 0], mine[:, 1]), mine[:, 2], 1)
        assert (np.degrees(np.arctan(slope)), lift) == pytest.approx(wanted, abs=6e-3)


def test_most_rays_leave_and_the_own_roof_hides_what_is_behind_and_below() -> None:
    elevation = np.degrees(np.arcsin(SENSOR.directions[:, 2]))
    azimuth = np.degrees(np.arctan2(SENSOR.directions[:, 1], SENSOR.directions[:, 0]))
    assert 0.92 < len(SENSOR.directions) / (64 * SENSOR.columns) < 0.96
    assert not ((elevation < -18) & (np.abs(azimuth) > 172)).any()
    assert (elevation > -14).sum() == (np.degrees(SENSOR.elevation) > -14).sum() * SENSOR.columns


def test_a_plane_lies_where_it_is_with_the_noise_of_the_sensor() -> None:
    points, words = SENSOR.scan(Target(plane(), DEVICE), None, pose_at(), np.random.default_rng(0))
    assert (words == classes.ROAD).all()
    above = 1.73 + SENSOR.lift[(SENSOR.elevation < -0.02).argmax() + rings_of(points)]  # the first beam that comes down
    from_laser = points[:, :3] - np.outer(above - 1.73, [0, 0, 1])
    distance = np.linalg.norm(from_laser, axis=1)
    true = above / -(from_laser[:, 2] / distance)
    near = true < 40
    assert (distance - true)[near].mean() == pytest.approx(0, abs=5e-4)
    assert (distance - true)[near].std() == pytest.approx(0.018, rel=0.03)
    assert distance.max() < 80.1
    assert (points[:, 2] < 0).all()  # nothing comes back from the sky
    assert ((points[:, 3] >= 0) & (points[:, 3] < 1)).all()
    # Grazing returns get lost: many at 70 m, few at 20 m.
    rays = -(1.73 + SENSOR._lifted) / np.minimum(SENSOR.directions[:, 2], -1e-9)
    kept = [((distance > a) & (distance < b)).sum() / ((rays > a) & (rays < b)).sum() for a, b in ((15, 25), (62, 78))]
    assert kept[0] > 0.97
    assert kept[1] < 0.85


def test_points_are_ordered_beam_by_beam_as_in_kittis_files() -> None:
    points, _ = SENSOR.scan(Target(plane(), DEVICE), None, pose_at(), np.random.default_rng(0))
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    turns = (np.diff(azimuth) < -5).sum() + 1
    assert turns == ((1.73 + SENSOR.lift) / np.tan(np.maximum(-SENSOR.elevation, 1e-9)) < 79).sum()


def test_the_nearer_of_standing_and_moving_is_seen_in_either_order() -> None:
    wall = box((10.0, 10.2), (-5, 5), (0, 3), classes.BUILDING, "plaster")
    car = box((6.0, 8.0), (-1, 1), (0, 1.5), classes.MOVING_CAR, "paint_light").at(0, 0, 0, 0, 7)
    for still, moving, wanted in (
        (wall, car, {classes.BUILDING, classes.MOVING_CAR}),
        (car, wall, {classes.BUILDING, classes.MOVING_CAR}),
    ):
        scene = Target(join([plane(), still]), DEVICE)
        points, words = SENSOR.scan(scene, Target(moving, DEVICE), pose_at(), np.random.default_rng(0))
        ahead = (np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.1) & (points[:, 2] > -1.2)
        low = ahead & (points[:, 2] < -0.45)
        assert set(classes.semantic(words[low])) == {classes.MOVING_CAR}
        assert (classes.instance(words[low]) == 7).all()
        assert set(classes.semantic(words[ahead])) == wanted
        np.testing.assert_allclose(points[low, 0], 6.0, atol=0.1)


@settings(max_examples=15, deadline=None)
@given(
    x=st.floats(-30, 30),
    y=st.floats(-30, 30),
    heading=st.floats(-3.1, 3.1),
    yaw=st.floats(-3.1, 3.1),
    kind=st.sampled_from(range(len(KINDS))),
)
def test_the_firings_that_are_cast_at_what_moves_miss_nothing(
    x: float, y: float, heading: float, yaw: float, kind: int
) -> None:
    """Casting at a chosen part of the firings sees the same points as casting all rays."""
    if np.hypot(x, y) < 4:
        x += 10
    body = models.road_user(kind, 4.5, 1.8).at(x, y, 0, heading, 1)
    pose = pose_at(yaw=yaw)
    hits = Target(body, DEVICE).hit(
        pose[:3, 3].astype(np.float32), SENSOR.directions @ pose[:3, :3].T.astype(np.float32)
    )
    struck = hits["primID"] >= 0
    nearest = SENSOR._nearest(body, pose)
    assert (nearest[SENSOR.column[struck]] < hits["tfar"][struck]).all()
    assert np.isfinite(nearest).mean() < 0.5
    if (away := np.hypot(x, y)) > 10:
        assert away - 12 < nearest.min() < away


@pytest.mark.parametrize(
    ("kind", "length", "width", "size"),
    [
        ("car", 4.5, 1.8, (4.5, 1.8, 1.42)),
        ("van", 5.4, 2.0, (5.4, 2.0, 2.25)),
        ("truck", 7.8, 2.4, (7.8, 2.4, 3.2)),
        ("bicycle", 1.8, 0.65, (1.8, 0.6, 1.75)),
        ("person", 0.5, 0.6, (0.6, 0.6, 1.75)),
    ],
)
def test_road_users_have_their_size(kind: str, length: float, width: float, size: tuple[float, float, float]) -> None:
    index = KINDS.index(kind)
    got = models.size_of(index, length, width)
    assert got == pytest.approx(size, abs=0.16)
    for phase in range(models.PHASES):
        body = models.road_user(index, length, width, True, phase)
        assert body.vertices[:, 2].min() == pytest.approx(0, abs=0.31)
        assert set(body.label) == {models.class_of(index, False)}


def test_light_falls_through_leaves_but_not_through_walls() -> None:
    rng = np.random.default_rng(0)
    rays = np.tile(np.array([1, 0, 0], np.float32), (400, 1))
    rays[:, 1] = np.linspace(-0.1, 0.1, 400)
    eye = np.array([-8, 0, 3.0], np.float32)
    through = {
        name: (Target(model, DEVICE).hit(eye, rays)["primID"] < 0).mean()
        for name, model in {
            "tree": furniture.tree(6, 1.5, 1.5, rng),
            "wall": furniture.wall(8, 4).at(0, 0, 0, np.pi / 2),
        }.items()
    }
    assert 0.1 < through["tree"] < 0.9
    assert through["wall"] == 0


@pytest.mark.parametrize(("beams", "highest", "lowest"), [(16, 15, -15), (32, 10.67, -30.67), (128, 22.5, -22.5)])
def test_other_scanners_have_the_beams_of_their_manuals(beams: int, highest: float, lowest: float) -> None:
    sensor = SENSORS[beams]
    degrees = np.degrees(sensor.elevation)
    assert (len(degrees), degrees[0], degrees[-1]) == pytest.approx((beams, highest, lowest), abs=0.01)
    assert len(sensor.directions) == len(sensor.column) == beams * sensor.columns


def test_a_scanner_that_moves_sees_each_column_from_its_own_place() -> None:
    """A wall 20 m ahead, driven at by 1 m within the turn: what is seen last is 1 m nearer."""
    sensor = Rings(columns=400, noise=0.0, beams=(0.0,))
    wall = Target(box((20, 21), (-50, 50), (0, 5), classes.BUILDING, "asphalt"), DEVICE)
    firing = np.stack([pose_at(x=k / 400) for k in range(400)])
    points, _ = sensor.scan(wall, None, pose_at(), np.random.default_rng(0), firing)
    turned = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2 * np.pi) / (2 * np.pi)
    np.testing.assert_allclose(points[:, 0], 20 - turned, atol=0.01)


def sheet(x: float, material: str, label: int = classes.VEGETATION) -> Mesh:
    """One face across the view ahead, `x` metres away."""
    return mesh([(x, -40, -40), (x, 40, -40), (x, 40, 40), (x, -40, 40)], [(0, 1, 2), (0, 2, 3)], label, material)


def seen(parts: list[Mesh], clutter: Clutter, **sensor: float) -> tuple[np.ndarray, np.ndarray]:
    """What a scanner of level beams sees ahead: points and words."""
    scanner = Rings(columns=2000, beams=tuple(np.linspace(1, -1, 20)), **sensor)
    points, words = scanner.scan(
        Target(join(parts), DEVICE), None, pose_at(z=0.0), np.random.default_rng(0), None, clutter
    )
    ahead = np.abs(points[:, 1]) < points[:, 0]
    return points[ahead], words[ahead]


def test_rays_pass_a_share_of_the_leaves_in_their_way_and_other_ones_in_every_scan() -> None:
    """Of four leaves in a row shares 1 - p, p (1 - p), p^2 (1 - p) and the rest are met: three are passed at most."""
    leaves = [sheet(x, "leaves") for x in (5.0, 6.0, 7.0, 8.0)]
    wall = sheet(9.0, "plaster", classes.BUILDING)
    points, words = seen([*leaves, wall], Clutter(porosity=0.5, grass=0, mixed=0, lost=0), noise=0.0, nearest=0.0)
    met = np.round(points[:, 0]).astype(int)
    returned = np.array([(met == x).sum() for x in (5, 6, 7, 8)]) / len(met)
    np.testing.assert_allclose(returned, [0.5, 0.25, 0.125, 0.125], atol=0.015)
    assert set(classes.semantic(words)) == {classes.VEGETATION}
    points, words = seen([sheet(5.0, "leaves"), wall], Clutter(0.3, 0, 0, 0), noise=0.0)
    assert (classes.semantic(words) == classes.BUILDING).mean() == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(points[classes.semantic(words) == classes.BUILDING, 0], 9.0, atol=1e-4)
    assert (seen([sheet(5.0, "twigs"), wall], Clutter(0.9, 0, 0, 0))[0][:, 0] < 6).all()
    scene, rng = Target(join([sheet(5.0, "leaves"), wall]), DEVICE), np.random.default_rng(0)
    first, second = (SENSOR.scan(scene, None, pose_at(z=0.0), rng, None, Clutter(0.5, 0, 0, 0))[1] for _ in range(2))
    assert len(first) != len(second) or (first != second).any()


def test_blades_of_grass_end_rays_before_the_ground_as_high_as_they_are() -> None:
    lawn = box((-300, 300), (-300, 300), (-1.0, 0.0), classes.TERRAIN, "grass")
    sensor = HDL64E(noise=0.0)
    bare, _ = sensor.scan(Target(lawn, DEVICE), None, pose_at(), np.random.default_rng(0))
    grown, _ = sensor.scan(
        Target(lawn, DEVICE), None, pose_at(), np.random.default_rng(0), None, Clutter(0, 0.03, 0, 0)
    )
    np.testing.assert_allclose(bare[:, 2], -1.73, atol=1e-3)
    near = np.hypot(grown[:, 0], grown[:, 1]) < 12  # further out a blade shortens a range by its most
    height = grown[near, 2] + 1.73
    assert height.min() > -1e-3
    assert (height.mean(), height.std()) == pytest.approx((0.03, 0.03), rel=0.04)


def test_ranges_on_edges_lie_between_both_sides_unless_these_are_far_apart() -> None:
    step = [box((5.0, 5.1), (-40, 0), (-9, 9), classes.BUILDING, "plaster"), sheet(6.0, "plaster")]
    points, _ = seen(step, Clutter(0, 0, mixed=1.0, lost=0), noise=0.0, nearest=0.0)
    between = (points[:, 0] > 5.01) & (points[:, 0] < 5.99)
    assert 10 <= between.sum() <= 20  # one of each beam's two rays on the edge
    far = [step[0], sheet(9.0, "plaster")]
    assert not (seen(far, Clutter(0, 0, 1.0, 0), noise=0.0)[0][:, 0] % 4 > 1.5).any()


def test_returns_get_lost_as_often_as_asked() -> None:
    wall = [sheet(5.0, "plaster")]
    whole, some = (len(seen(wall, Clutter(0, 0, 0, lost))[0]) for lost in (0.0, 0.1))
    assert some / whole == pytest.approx(0.9, abs=0.01)


def test_clutter_differs_from_drive_to_drive() -> None:
    drawn = [Clutter.draw(np.random.default_rng(k)) for k in range(20)]
    for name in ("porosity", "grass", "mixed", "lost"):
        values = [getattr(clutter, name) for clutter in drawn]
        assert 0 <= min(values) < 0.5 * max(values) < max(values) < 0.8
