"""The store: what is in it is whole, what is not whole is not in it."""

import json
import os
import platform
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.cli.commands import verify
from envpred.errors import UserError
from envpred.mapping.geometry import Body, GridSpec
from envpred.store import FORMAT, MANIFEST, DriveWriter, Store, StoredDrive, digest, sweep
from tests.store.stores import write_store

PARAMETERS = {"grid": {"cells": 8, "resolution": 1 / 3}, "sensor": "calibration"}
FRAMES = 5


def label(seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 4, (FRAMES, 8, 8)).astype(np.uint8)


def write(
    store: Path,
    drive: str = "a",
    group: str = "mapping",
    key: str | None = None,
    arrays: dict[str, NDArray[Any]] | None = None,
) -> Path:
    key = key or Store(store).claim(group, PARAMETERS)
    about = {
        "drive": drive,
        "frames": [3, 4, 5, 8, 9],
        "stretches": [(0, 3), (3, 2)],
        "lattice": {"origin": [1.5, -2.0], "resolution": 1 / 3, "cells": 8, "context": 16},
        "period": 0.05,
        "sensor": np.diag([1.0, 1, 1, 1]).tolist(),
        "body": {"rear": -1.0, "front": 2.0, "half_width": 0.9},
    }
    with DriveWriter(store, drive, group, key, about) as out:
        for name, values in (arrays or {"label": label(), "time": np.arange(5.0)}).items():
            out.add(name, values.dtype, values.shape).extend(values)
    return store / drive


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write(tmp_path / "grids")
    return tmp_path / "grids"


class Killed(BaseException):
    """Stands for SIGKILL: nothing of ours catches it."""


@pytest.fixture
def dies_before_manifest(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From the call on, replacing a manifest ends the writer, and so does every step of its cleaning up."""

    def arm() -> None:
        real = os.replace

        def replace(source: Path, target: Path) -> None:
            if Path(target).name == MANIFEST:
                raise Killed
            real(source, target)

        monkeypatch.setattr(os, "replace", replace)
        monkeypatch.setattr(shutil, "rmtree", lambda *_, **__: None)

    return arm


def test_round_trip(store: Path) -> None:
    drive = Store(store).drives["a"]
    np.testing.assert_array_equal(drive.array("label"), label())
    np.testing.assert_array_equal(drive.array("time"), np.arange(5.0))
    assert drive.array("label").dtype == np.uint8
    assert drive.frames == [3, 4, 5, 8, 9]
    assert drive.stretches == [(0, 3), (3, 2)]
    np.testing.assert_array_equal(drive.origin, [1.5, -2.0])
    assert (drive.grid, drive.context) == (GridSpec(8), GridSpec(16))
    assert (drive.period, drive.body) == (0.05, Body(-1, 2, 0.9))
    np.testing.assert_array_equal(drive.sensor_to_body, np.eye(4))
    assert drive.has("label")
    assert not drive.has("velocity")
    np.testing.assert_array_equal(np.load(store / "a" / "label.npy"), label())  # plain NumPy reads it too
    assert Store(store).parameters("mapping") == PARAMETERS
    drive.verify()


def test_arrays_are_read_only(store: Path) -> None:
    with pytest.raises(ValueError, match="read-only"):
        StoredDrive(store / "a").array("label")[0] = 0


def test_manifest_holds_names_but_no_absolute_path(store: Path) -> None:
    text = (store / "a" / MANIFEST).read_text() + (store / "store.json").read_text()
    assert str(store.parent) not in text


def test_manifest_is_written_last_and_the_drive_appears_by_one_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[str]] = []
    real = os.rename

    def rename(source: Path, target: Path) -> None:
        assert not Path(target).exists()
        seen.append(sorted(file.name for file in Path(source).iterdir()))
        ages = {file.name: file.stat().st_mtime_ns for file in Path(source).iterdir()}
        assert max(ages, key=lambda name: ages[name]) == MANIFEST
        real(source, target)

    monkeypatch.setattr(os, "rename", rename)
    write(tmp_path / "grids")
    assert seen == [["label.npy", MANIFEST, "time.npy"]]
    assert sorted(file.name for file in (tmp_path / "grids").iterdir()) == ["a", "store.json"]


def test_failure_while_writing_leaves_nothing(tmp_path: Path) -> None:
    key = Store(tmp_path).claim("mapping", PARAMETERS)

    def fail() -> None:
        with DriveWriter(tmp_path, "a", "mapping", key, {}) as out:
            out.add("label", np.uint8, (FRAMES, 8, 8)).append(label()[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert [file.name for file in tmp_path.iterdir()] == ["store.json"]


def test_too_few_frames_are_not_published(tmp_path: Path) -> None:
    key = Store(tmp_path).claim("mapping", PARAMETERS)

    def fall_short() -> None:
        with DriveWriter(tmp_path, "a", "mapping", key, {}) as out:
            out.add("label", np.uint8, (FRAMES, 8, 8)).extend(label()[:4])

    with pytest.raises(ValueError, match="4 of 5 frames"):
        fall_short()
    assert Store(tmp_path).drives == {}


def test_frame_of_another_shape_is_refused(tmp_path: Path) -> None:
    key = Store(tmp_path).claim("mapping", PARAMETERS)
    with (
        pytest.raises(ValueError, match=r"\(8, 9\) where \(8, 8\)"),
        DriveWriter(tmp_path, "a", "mapping", key, {}) as out,
    ):
        out.add("label", np.uint8, (FRAMES, 8, 8)).append(np.zeros((8, 9), np.uint8))


VELOCITY = np.ones((FRAMES, 2, 8, 8), np.float16)


def test_further_group_completes_a_drive(store: Path) -> None:
    before = json.loads((store / "a" / MANIFEST).read_text())
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    drive = Store(store).drives["a"]
    np.testing.assert_array_equal(drive.array("velocity"), VELOCITY)
    np.testing.assert_array_equal(drive.array("label"), label())
    assert drive.manifest["groups"] == {**before["groups"], "dogma": "k1"}
    assert {name: drive.manifest["arrays"][name] for name in before["arrays"]} == before["arrays"]
    assert drive.frames == before["frames"]
    drive.verify()


def test_group_needs_a_drive(store: Path) -> None:
    with pytest.raises(UserError, match="missing"):
        write(store, "b", group="dogma", key="k1", arrays={"velocity": VELOCITY})


def test_crash_between_arrays_and_manifest_leaves_the_drive_as_it_was(
    store: Path, dies_before_manifest: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context():
        dies_before_manifest()
        with pytest.raises(Killed):
            write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    monkeypatch.undo()
    assert (store / "a" / "velocity.npy").exists()  # the crash came after the array was in place
    drive = Store(store).drives["a"]
    drive.verify()
    assert not drive.has("velocity")
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    Store(store).drives["a"].verify()
    assert {file.name for file in (store / "a").iterdir()} == {"label.npy", "time.npy", "velocity.npy", MANIFEST}


@pytest.mark.parametrize("group", ["mapping", "dogma"])
def test_crash_while_a_group_is_built_again_leaves_the_old_one(
    store: Path, group: str, dies_before_manifest: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    new = {"label": label(1)} if group == "mapping" else {"velocity": 2 * VELOCITY}
    dies_before_manifest()
    with pytest.raises(Killed):
        write(store, group=group, key="k2", arrays=new)
    monkeypatch.undo()
    drive = Store(store).drives["a"]
    drive.verify()
    np.testing.assert_array_equal(drive.array("label"), label())
    np.testing.assert_array_equal(drive.array("velocity"), VELOCITY)


def test_group_built_again_replaces_all_its_arrays(store: Path) -> None:
    forecast = np.zeros((FRAMES, 3), np.uint8)
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY, "particle_forecast": forecast})
    for times in (2, 3, 4):
        write(store, group="dogma", key=f"k{times}", arrays={"velocity": times * VELOCITY})
        drive = Store(store).drives["a"]
        drive.verify()
        np.testing.assert_array_equal(drive.array("velocity"), times * VELOCITY)
        np.testing.assert_array_equal(drive.array("label"), label())
        assert not drive.has("particle_forecast")
        assert len(list((store / "a").glob("*.npy"))) == 3


def test_mapping_built_again_drops_what_was_made_from_the_old(store: Path) -> None:
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    write(store, key="k2", arrays={"label": label(1)})
    drive = Store(store).drives["a"]
    drive.verify()
    np.testing.assert_array_equal(drive.array("label"), label(1))
    assert drive.manifest["groups"] == {"mapping": "k2"}
    assert len(list((store / "a").iterdir())) == 2


def test_group_of_a_drive_mapped_anew_meanwhile_is_refused(store: Path) -> None:
    def complete_too_late() -> None:
        with DriveWriter(store, "a", "dogma", "k1", {}) as out:
            out.add("velocity", np.float16, VELOCITY.shape).extend(VELOCITY)
            write(store, key="k2")

    with pytest.raises(UserError, match="mapped anew"):
        complete_too_late()
    assert not Store(store).drives["a"].has("velocity")


def test_unfinished_folder_is_ignored_and_built_again(store: Path) -> None:
    (store / "b").mkdir()
    (store / "b" / "label.npy").write_bytes(b"half")
    (store / "b" / "old.npy").write_bytes(b"half")
    found = Store(store)
    assert list(found.drives) == ["a"]
    assert found.unfinished() == ["b"]
    write(store, "b")
    assert list(Store(store).drives) == ["a", "b"]
    assert {file.name for file in (store / "b").iterdir()} == {"label.npy", "time.npy", MANIFEST}


def test_flipped_byte_is_found(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(store, "b")
    file = store / "a" / "label.npy"
    data = bytearray(file.read_bytes())
    data[-7] ^= 1
    file.write_bytes(data)
    with pytest.raises(UserError, match=r"a/label\.npy: its content has changed.*\n1 of 2 drives are damaged"):
        verify(store)
    assert "b: 5 frames, good" in capsys.readouterr().out  # the others are looked at too


@pytest.mark.parametrize("keep", [0, 10, 130, -1])
def test_truncated_array_is_an_error_that_names_it(store: Path, keep: int) -> None:
    file = store / "a" / "label.npy"
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(UserError, match=r"a/label\.npy: missing or damaged; delete .*/a and run"):
        StoredDrive(store / "a").array("label")


def test_missing_array_is_an_error_that_names_it(store: Path) -> None:
    (store / "a" / "label.npy").unlink()
    with pytest.raises(UserError, match=r"a/label\.npy: missing"):
        StoredDrive(store / "a").verify()


def test_array_of_another_shape_is_refused(store: Path) -> None:
    np.save(store / "a" / "label.npy", label()[:3])
    with pytest.raises(UserError, match=r"label\.npy: uint8\(3, 8, 8\) is not what its manifest says"):
        StoredDrive(store / "a").array("label")


def test_pickled_array_is_not_loaded(store: Path) -> None:
    np.save(store / "a" / "label.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(UserError, match="missing or damaged"):
        StoredDrive(store / "a").array("label")


def test_array_that_was_never_made_names_the_command(store: Path) -> None:
    with pytest.raises(UserError, match=r"no array 'velocity'; build it with `envpred grids"):
        StoredDrive(store / "a").array("velocity")


@pytest.mark.parametrize("content", ["", "{", "[]", "null"])
def test_damaged_manifest_is_named(store: Path, content: str) -> None:
    (store / "a" / MANIFEST).write_text(content)
    with pytest.raises(UserError, match=r"a/manifest\.json: cannot be read as JSON"):
        _ = StoredDrive(store / "a").manifest


@pytest.mark.parametrize("file", ["store.json", "a/manifest.json"])
def test_other_format_is_refused(store: Path, file: str) -> None:
    content = json.loads((store / file).read_text())
    (store / file).write_text(json.dumps({**content, "format": 99}))
    with pytest.raises(UserError, match=rf"{file}: format 99 is not {FORMAT}"):
        _ = Store(store).drives["a"].manifest


def test_folder_that_is_no_store(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"store\.json is missing"):
        _ = Store(tmp_path).drives
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match="holds other files"):
        Store(tmp_path).claim("mapping", PARAMETERS, force=True)
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(UserError, match="no store"):
        Store(tmp_path / "thesis.tex").claim("mapping", PARAMETERS)


def test_folder_where_the_index_was_half_written_can_be_claimed(tmp_path: Path) -> None:
    (tmp_path / ".store.json-123").write_text('{"form')
    assert Store(tmp_path).claim("mapping", PARAMETERS) == digest(PARAMETERS)


def test_other_parameters_are_refused_and_nothing_is_touched(store: Path) -> None:
    before = {file: file.read_bytes() for file in store.rglob("*") if file.is_file()}
    other = {"grid": {"cells": 16, "resolution": 1 / 3}, "sensor": "calibration"}
    with pytest.raises(UserError, match=r"\(grid\.cells 8 there, 16 asked\).*--force"):
        Store(store).claim("mapping", other)
    assert {file: file.read_bytes() for file in store.rglob("*") if file.is_file()} == before


def test_force_notes_the_new_parameters_and_keeps_drives_and_other_groups(store: Path) -> None:
    Store(store).claim("dogma", {"particles": 100})
    key = Store(store).claim("mapping", {"sensor": "paper"}, force=True)
    assert key == digest({"sensor": "paper"})
    assert Store(store).parameters("mapping") == {"sensor": "paper"}
    assert Store(store).parameters("dogma") == {"particles": 100}
    Store(store).drives["a"].verify()


def test_digest_depends_on_values_but_not_on_their_order() -> None:
    assert digest({"a": 1, "b": [1, 2]}) == digest({"b": [1, 2], "a": 1})
    assert digest({"a": 1, "b": [1, 2]}) != digest({"a": 1, "b": [2, 1]})


def test_sweep_removes_parts_of_dead_writers_only(store: Path) -> None:
    node = platform.node()
    dead = 2**22 + 1  # above the largest process number that Linux gives
    living = store / f".part-b-{node}-{os.getppid()}"
    elsewhere = store / ".part-c-anothermachine-1"
    forgotten = store / ".part-d-anothermachine-1"
    for part in (store / f".part-a-{node}-{dead}", living, elsewhere, forgotten):
        part.mkdir()
        (part / "label.npy").write_bytes(b"half")
    for file in (forgotten, forgotten / "label.npy"):
        os.utime(file, (0, 0))
    sweep(store)
    assert {file.name for file in store.glob(".part-*")} == {living.name, elsewhere.name}
    assert list(Store(store).drives) == ["a"]


def test_the_tests_own_store_has_both_grids(tmp_path: Path) -> None:
    drive = Store(write_store(tmp_path, {"a": [0, 1, 2]}, cells=8, context=16, period=0.05)).drives["a"]
    assert (drive.grid.cells, drive.context, drive.period) == (8, GridSpec(16), 0.05)
    np.testing.assert_array_equal(drive.array("context_label")[:, 4:-4, 4:-4], drive.array("label"))
    assert drive.array("context_evidence").shape == (3, 2, 16, 16)
