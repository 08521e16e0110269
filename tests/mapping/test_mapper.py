"""The mapper: both grids from one pass, gaps, another car, another period, velocities."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.dogma import DogmaParameters, run
from envpred.mapping.evidence import measured
from envpred.mapping.geometry import EGO, OCCUPIED, UNKNOWN, Body, GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField, RansacPlane
from envpred.mapping.mapper import Mapped, Mapper, MappingParameters
from envpred.mapping.particle_state import ParticleFilterParameters
from tests.drives.synthetic import motion, scans

SMALL = GridSpec(cells=24)
POSES = motion(6, speed=5.0, weave=0.3)
SCANS = scans(POSES)


def pose_of(east: float, heading: float, pitch: float) -> NDArray[np.float64]:
    """A pose (4, 4): turned about its own y axis, then about z."""
    pose = np.eye(4)
    pose[0, 3] = east
    c, s, cp, sp = np.cos(heading), np.sin(heading), np.cos(pitch), np.sin(pitch)
    pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return pose


def steps(mapper: Mapper, period: float = 0.1) -> list[Mapped]:
    return [mapper.step(*both, period * t) for t, both in enumerate(zip(SCANS, POSES, strict=True))]


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([MarkovRandomField(), MarkovRandomField(cell=0.9), RansacPlane(trials=10)]),
    st.floats(-3.2, 3.2),
    st.floats(-0.3, 0.3),
    st.sampled_from([24, 26, 60]),
)
def test_the_judged_grid_is_what_it_is_alone(
    seed: int, segmenter: GroundSegmenter, heading: float, pitch: float, context: int
) -> None:
    random = np.random.default_rng(seed)
    parameters = MappingParameters(SMALL, segmenter)
    alone, both = Mapper(parameters), Mapper(parameters, context=context)
    for t in range(3):
        points = random.uniform(-1, 1, (400, 4)) * (9, 9, 1, 1) - (0, 0, 1, 0)
        pose = pose_of(0.4 * t, heading, pitch)
        one, other = (mapper.step(points.astype(np.float32), pose, 0.1 * t) for mapper in (alone, both))
        for name in ("label", "mass", "centre_cell"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_both_grids_see_the_same_world() -> None:
    """Within the judged grid they differ by nothing but rays, which the wider one casts to other cells."""
    both = steps(Mapper(context=256))
    for frame in both:
        assert frame.context_label is not None
        middle = frame.context_label[64:-64, 64:-64]
        occupied = frame.label == OCCUPIED
        np.testing.assert_array_equal(middle == OCCUPIED, occupied)
        np.testing.assert_array_equal(middle == EGO, frame.label == EGO)
        assert (middle == frame.label).mean() > 0.98


@pytest.mark.parametrize("segmenter", [MarkovRandomField(), RansacPlane()])
def test_a_wall_at_36_m_is_in_the_wider_grid(segmenter: GroundSegmenter) -> None:
    x, y = np.meshgrid(np.arange(-40, 40, 0.3), np.arange(-40, 40, 0.3))
    road = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.73), 0 * x.ravel()], axis=1)
    wall = np.array([[36.0, y, z, 0] for y in np.arange(-9, 9, 0.1) for z in (-1.2, -0.5, 0.3)])
    points = np.concatenate([road, wall]).astype(np.float32)
    frame = Mapper(MappingParameters(ground=segmenter), context=256).step(points, np.eye(4), 0)
    wide = Mapper(MappingParameters(GridSpec(256), segmenter)).step(points, np.eye(4), 0).label
    for label in (frame.context_label, wide):
        assert label is not None
        i, j = np.nonzero(label == OCCUPIED)
        assert len(i) >= 50
        assert np.abs((i - 128) / 3 - 36.8).max() < 0.4
        assert np.abs(j - 128).max() < 32
    assert not (frame.label == OCCUPIED).any()


@pytest.mark.parametrize("cells", [126, 129, 0])
def test_a_wider_grid_that_is_none_is_one_line(cells: int) -> None:
    with pytest.raises(UserError, match=f"--context {cells}: give an even number of cells of at least the grid's 128"):
        Mapper(context=cells)


def test_reset_and_gaps_forget_what_was_seen() -> None:
    mapper = Mapper(context=160, velocities=DogmaParameters(ParticleFilterParameters(500, 50)))
    first = mapper.step(SCANS[0], POSES[0], 0.0)
    later = mapper.step(SCANS[1], POSES[1], 0.1)
    mapper.reset()
    after_reset = mapper.step(SCANS[1], POSES[1], 5.0)
    mapper.step(SCANS[0], POSES[0], 5.1)
    after_gap = mapper.step(SCANS[1], POSES[1], 5.26)
    assert first.context_mass is not None
    for fresh in (after_reset, after_gap):
        assert fresh.velocities is not None
        np.testing.assert_array_equal(fresh.mass, measured(fresh.label))
        assert fresh.context_label is not None
        np.testing.assert_array_equal(fresh.context_mass, measured(fresh.context_label))
        assert not fresh.velocities.velocity.any()  # no particle has persisted
    assert (later.mass != after_reset.mass).any()
    with pytest.raises(ValueError, match="does not follow"):
        mapper.step(SCANS[2], POSES[2], 5.26)


def test_the_lattice_lies_where_the_first_pose_puts_it() -> None:
    mapper, moved = Mapper(), Mapper(origin=np.array([0.11, -3.0]))
    frame, other = (m.step(SCANS[0], POSES[0], 0.0) for m in (mapper, moved))
    np.testing.assert_array_equal(frame.centre_cell, [128, 128])
    np.testing.assert_array_equal(other.centre_cell, [0, 9])


def test_another_car_covers_other_cells_and_hides_other_returns() -> None:
    truck = Mapper(body=Body(rear=-6.0, front=2.0, half_width=1.2))
    points = np.array([[-5, 0.5, z, 0] for z in (-1.5, 0.0)] + [[9, 9, z, 0] for z in (-1.5, 0.0)], np.float32)
    own, car = (mapper.step(points, np.eye(4), 0).label for mapper in (truck, Mapper()))
    assert (car == OCCUPIED).sum() == 2
    assert (own == OCCUPIED).sum() == 1  # a return from its own rear
    # Half a cell more or less at each side of (8 + 2/3) x (2.4 + 2/3) m.
    assert (own == EGO).sum() == pytest.approx(26 * 9.2, rel=0.1)


def test_the_sensors_height_is_where_the_road_is_looked_for() -> None:
    low = np.array([[2.5, 0.1 * y, -0.71, 0] for y in range(-20, 20)], np.float32)  # a road 0.71 m below the sensor
    assert not Mapper(sensor_height=0.7).step(low, np.eye(4), 0).obstacle.any()
    assert Mapper().step(low, np.eye(4), 0).obstacle.all()


def test_a_second_without_a_look_fades_alike_at_10_and_20_hz() -> None:
    azimuth = np.linspace(0, 2 * np.pi, 720)
    fence = np.array([[5 * np.cos(a), 5 * np.sin(a), z, 0] for a in azimuth for z in (-1.5, 0.0)], np.float32)
    faded = []
    for period in (0.1, 0.05):
        mapper = Mapper(period=period)
        first = mapper.step(SCANS[0], POSES[0], 0.0)
        for t in range(1, round(1 / period) + 1):
            frame = mapper.step(fence, POSES[0], period * t)
        hidden = frame.label == UNKNOWN
        assert (first.mass[:, hidden].max(axis=1) > 0.9).all()
        faded.append(frame.mass[:, hidden])
    np.testing.assert_allclose(faded[0], faded[1], atol=1e-6)
    assert 0.3 < faded[0].max() < 0.35  # 0.95 x 0.9^10


def test_velocities_are_those_of_the_job() -> None:
    parameters = DogmaParameters(ParticleFilterParameters(2000, 200))
    frames = steps(Mapper(velocities=parameters, with_forecast=True))
    labels, cells = np.stack([f.label for f in frames]), np.stack([f.centre_cell for f in frames])
    whole = run(measured(labels), cells, parameters, with_forecast=True)
    assert whole.forecast is not None
    for t, frame in enumerate(frames):
        assert frame.velocities is not None
        assert frame.velocities.forecast is not None
        np.testing.assert_array_equal(frame.velocities.velocity, whole.velocity[t])
        np.testing.assert_array_equal(frame.velocities.covariance, whole.covariance[t])
        np.testing.assert_array_equal(frame.velocities.forecast, whole.forecast[t])
    assert steps(Mapper())[0].velocities is None
