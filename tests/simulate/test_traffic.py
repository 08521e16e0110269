"""Recordings of traffic: what is written is read back, and tracks become smooth motion."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.simulate import record
from envpred.simulate.run import builtin_recording
from envpred.simulate.streets import TOWNS, write_network
from envpred.simulate.traffic import KINDS, LANES, RATE, Network, Recording, Track
from tests.remedies import installs, remedy


def recording_of(*tracks: Track) -> Recording:
    lane = (LANES.index("driving"), 3.0, np.array([[0.0, 0.0], [50.0, 1.234]]))
    return Recording(0.5, 60.0, [Network("here", [lane], [np.array([[0.0, 0], [1, 0], [1, 1]])], list(tracks))])


def test_what_is_saved_is_loaded_to_the_centimetre(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    tracks = [
        Track(2, 7.8, 2.4, 3, 0.5, rng.uniform(-400, 400, (9, 2))),
        Track(4, 0.5, 0.6, 0, -1.0, rng.uniform(0, 9, (4, 2))),
    ]
    recording_of(*tracks).save(tmp_path / "r.npz")
    back = Recording.load(tmp_path / "r.npz")
    town = back.networks[0]
    assert (back.interval, back.seconds, town.name) == (0.5, 60.0, "here")
    assert town.lanes[0][:2] == (LANES.index("driving"), 3.0)
    np.testing.assert_allclose(town.lanes[0][2], np.array([[0, 0], [50, 1.23]]), atol=1e-9)
    for old, new in zip(tracks, town.tracks, strict=True):
        assert (new.kind, new.start) == (old.kind, old.start)
        assert (new.length, new.width, new.heading) == pytest.approx((old.length, old.width, old.heading))
        np.testing.assert_allclose(new.places, old.places, atol=0.00501)


def test_a_car_on_a_straight_drives_straight() -> None:
    t = np.arange(20) * 0.5
    heading = 0.6
    front = np.outer(8.0 * t, [np.cos(heading), np.sin(heading)])
    motion = recording_of(Track(0, 4.5, 1.8, 6, heading, front)).motions(0)[0]
    assert motion.first == 30  # sample 6 of 0.5 s at ten scans a second
    assert len(motion.speed) == 96
    np.testing.assert_allclose(motion.heading, heading, atol=1e-6)
    np.testing.assert_allclose(motion.speed[15:-15], 8.0, rtol=1e-3)
    # The body's centre is half a length behind the front, the rear axle 0.8 of it.
    behind = front[10] - motion.centre[50]
    np.testing.assert_allclose(np.hypot(*behind), 2.25, atol=1e-3)
    np.testing.assert_allclose(np.hypot(*(front[10] - motion.rear_axle[50])), 3.6, atol=1e-3)


def test_the_rear_axle_cuts_the_corner_as_a_towed_axle_does() -> None:
    """On a circle of radius R a drawbar d leaves the rear axle on one of radius sqrt(R^2 - d^2)."""
    radius, drawbar, speed = 12.0, 0.8 * 5.0, 5.0
    angle = np.arange(120) * 0.5 * speed / radius
    front = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    motion = recording_of(Track(0, 5.0, 1.8, 0, np.pi / 2, front)).motions(0)[0]
    # The filter that smooths corners pulls the front inwards by a factor exp(-(w s)^2 / 2).
    smoothed = radius * np.exp(-((speed / radius * 0.3) ** 2) / 2)
    settled = slice(300, -20)
    np.testing.assert_allclose(np.hypot(*motion.rear_axle[settled].T), np.sqrt(smoothed**2 - drawbar**2), atol=0.02)
    assert np.diff(motion.heading)[settled].mean() == pytest.approx(0.1 * speed / radius, rel=0.01)


def test_who_stands_keeps_its_heading() -> None:
    motion = recording_of(Track(4, 0.5, 0.6, 0, 1.0, np.full((8, 2), 3.0))).motions(0)[0]
    np.testing.assert_allclose(motion.heading, 1.0)
    np.testing.assert_allclose(motion.speed, 0.0, atol=1e-9)


def test_the_recording_that_ships_is_small_and_has_everybody() -> None:
    path = builtin_recording()
    assert path.stat().st_size < 5_000_000
    recording = Recording.load(path)
    assert [n.name for n in recording.networks] == [t.name for t in TOWNS]
    assert recording.seconds >= 180
    for k, network in enumerate(recording.networks):
        lanes = {"driving", "sidewalk", "junction"} | ({"crossing"} if network.name != "rural" else set())
        assert {LANES[lane[0]] for lane in network.lanes} >= lanes
        motions = recording.motions(k)
        assert {KINDS[m.kind] for m in motions} >= {"car", "van", "bicycle", "person"}
        cars = np.concatenate([m.speed for m in motions if KINDS[m.kind] == "car"])
        rates = np.concatenate([np.gradient(m.heading) * RATE for m in motions if KINDS[m.kind] == "car"])
        turning = (np.abs(rates) > 0.1)[cars > 1].mean()
        assert cars.max() < 18
        assert 0.05 < (cars < 0.3).mean() < 0.6  # they stop at lights and drive on
        if network.name == "rural":  # as KITTI's 0013 is driven
            assert turning < 0.1
            assert 10.5 < np.median(cars) < 13
        if network.name == "crescents":  # as 0005 is
            assert turning > 0.8
            assert 3 < np.median(cars) < 6.5
        turns = np.concatenate([np.diff(m.heading) for m in motions if KINDS[m.kind] == "car"])
        assert np.abs(turns).max() < 0.35  # radians a scan: nobody spins


def test_cars_do_not_drive_through_each_other() -> None:
    recording = Recording.load(builtin_recording())
    for k in range(len(recording.networks)):
        cars = [m for m in recording.motions(k) if KINDS[m.kind] in ("car", "van")]
        for scan in range(500, 2500, 250):
            places = np.array([m.centre[scan - m.first] for m in cars if 0 <= scan - m.first < len(m.speed)])
            gaps = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 1e9 * np.eye(len(places))
            assert np.median(gaps.min(axis=1)) > 4
            assert (gaps.min(axis=1) < 1.2).mean() < 0.05


@pytest.mark.parametrize("content", [None, b"", b"no zip", "npz", "version", "kinds", "points"])
def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path, content: bytes | str | None) -> None:
    path = tmp_path / "x.npz"
    if content == "npz":
        np.savez(path, a=np.zeros(3))
    elif content in ("version", "kinds", "points"):
        recording_of(Track(0, 4.5, 1.8, 6, 0.0, np.zeros((8, 2)))).save(path)
        with np.load(path) as arrays:
            kinds = arrays["0/lane_kind"] + 99
            changed = {"version": {"version": 99}, "kinds": {"0/lane_kind": kinds}, "points": {"0/track_count": [7]}}
            np.savez(path, **(dict(arrays) | changed[content]))
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(UserError, match=r"x\.npz: .* give another, or none to use the built-in one") as caught:
        Recording.load(path)
    assert "\n" not in str(caught.value)


def test_a_network_is_drawn_from_its_seed(tmp_path: Path) -> None:
    texts = []
    for seed in (1, 1, 2):
        files = write_network(TOWNS[0], seed, tmp_path)
        texts.append("".join(f.read_text() for f in files))
    assert texts[0] == texts[1] != texts[2]


def test_recording_needs_sumo_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "libsumo", None)
    with pytest.raises(UserError, match="recording traffic needs SUMO") as failure:
        record.record(tmp_path / "r.npz")
    (command,) = remedy(failure.value)
    assert {"eclipse-sumo", "libsumo", "sumolib"} <= installs(command)


def test_what_cannot_be_recorded_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too few seconds, and a town that SUMO's own program makes no network of."""
    for name in ("libsumo", "sumo", "sumolib"):
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(SUMO_HOME=tmp_path))
    with pytest.raises(UserError, match="--seconds 3: give a number of at least 10"):
        record.record(tmp_path / "r.npz", seconds=3)
    program = tmp_path / "bin" / "netconvert"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho no edges >&2; exit 1")
    program.chmod(0o755)
    with pytest.raises(UserError, match=f"netconvert failed on the network {TOWNS[0].name}: no edges"):
        record.record(tmp_path / "r.npz")
    assert not (tmp_path / "r.npz").exists()


@pytest.mark.slow
def test_sumo_records_a_town_the_same_way_twice(tmp_path: Path) -> None:
    pytest.importorskip("libsumo")
    for name in ("a.npz", "b.npz"):
        record.record(tmp_path / name, seconds=20, seed=5, towns=TOWNS[:1])
    a, b = (Recording.load(tmp_path / name).networks[0] for name in ("a.npz", "b.npz"))
    assert len(a.tracks) == len(b.tracks) > 20
    for x, y in zip(a.tracks, b.tracks, strict=True):
        np.testing.assert_array_equal(x.places, y.places)
