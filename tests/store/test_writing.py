"""Writing into a store: what is not whole is not in it, whatever interrupts."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.store import MANIFEST, DriveWriter, Store
from envpred.store.parts import LOCK, MARK, Part
from tests.remedies import remedy
from tests.store.small import FRAMES, PARAMETERS, VELOCITY, label, write


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
        monkeypatch.setattr(Part, "discard", lambda part: part.lock.release())

    return arm


def test_a_drive_that_is_a_link_to_another_disk_is_completed_there(store: Path) -> None:
    if os.stat("/dev/shm").st_dev == store.stat().st_dev:
        pytest.skip("no other disk to be written is at /dev/shm")
    with tempfile.TemporaryDirectory(dir="/dev/shm") as disk:
        shutil.move(store / "a", disk)
        (store / "a").symlink_to(Path(disk, "a"))
        write(store, group="dogma", arrays={"velocity": VELOCITY})
        write(store, arrays={"label": label(1), "time": np.arange(5.0)})
        drive = Store(store).drives["a"]
        drive.verify()
        assert (drive.array("label") == label(1)).all()
        assert not {file.name for file in store.iterdir()} - {".lock", "a", "store.json"}
        assert (store / "a").is_symlink()
        assert {file.suffix for file in Path(disk, "a").iterdir()} == {".json", ".npy"}


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
    assert seen == [[MARK, "label.npy", MANIFEST, "time.npy"]]
    assert sorted(file.name for file in (tmp_path / "grids").iterdir()) == [LOCK, "a", "store.json"]
    assert not (tmp_path / "grids" / "a" / MARK).exists()


def test_failure_while_writing_leaves_nothing(tmp_path: Path) -> None:
    key = Store(tmp_path).claim("mapping", PARAMETERS)

    def fail() -> None:
        with DriveWriter(tmp_path, "a", "mapping", key, {}) as out:
            out.add("label", np.uint8, (FRAMES, 8, 8)).append(label()[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert {file.name for file in tmp_path.iterdir()} == {LOCK, "store.json"}


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
    forecast = np.zeros((FRAMES, 3, 8, 8), np.uint8)
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


def test_group_of_a_drive_removed_meanwhile_is_refused(store: Path) -> None:
    def complete_too_late() -> None:
        with DriveWriter(store, "a", "dogma", "k1", {}) as out:
            out.add("velocity", np.float16, VELOCITY.shape).extend(VELOCITY)
            shutil.rmtree(store / "a")

    with pytest.raises(UserError, match=r"/a: was removed while dogma was built; run again"):
        complete_too_late()
    assert not (store / "a").exists()


def test_a_folder_that_is_no_drive_is_ignored_and_left_alone(store: Path) -> None:
    (store / "b").mkdir()
    (store / "b" / "label.npy").write_bytes(b"a thesis")
    found = Store(store)
    assert list(found.drives) == ["a"]
    assert found.unfinished() == ["b"]
    with pytest.raises(UserError, match=r"b: has no manifest.json, .* move it away") as failure:
        write(store, "b")
    assert remedy(failure.value) == [["--store"]]
    write(store.parent / "other", "b")
    assert (store / "b" / "label.npy").read_bytes() == b"a thesis"
    assert not list(store.glob(".part-*"))
    (store / "b").rename(store.parent / "away")
    (store / "b").mkdir()  # an empty one holds nothing to lose
    write(store, "b")
    assert list(Store(store).drives) == ["a", "b"]


def test_foreign_files_beside_arrays_stay(store: Path) -> None:
    notes = store / "a" / "notes.npy"
    notes.write_bytes(b"mine")
    (store / "a" / "label.1.npy").write_bytes(b"of a killed writer")
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    assert notes.read_bytes() == b"mine"
    assert not (store / "a" / "label.1.npy").exists()
    write(store, key="k2", arrays={"label": label(1)})
    assert {file.name for file in (store / "a").iterdir()} == {"label.1.npy", "notes.npy", MANIFEST}


@pytest.mark.parametrize("how", ["cut", "removed", "replaced"])
def test_an_array_that_is_not_what_was_written_is_not_published(store: Path, how: str) -> None:
    """As where another process takes the part for one that was left, and writes its own drive in its place."""
    large = np.ones((FRAMES, 128, 128), np.uint8)

    def write_beside() -> None:
        key = Store(store).claim("mapping", PARAMETERS)
        with DriveWriter(store, "b", "mapping", key, {}) as out:
            written = out.add("label", np.uint8, large.shape)
            for frame in large:
                if written.written == 2 and how == "cut":
                    written.file.write_bytes(b"")  # what follows is written behind a hole
                written.append(frame)
            if how != "cut":
                written.file.unlink()
            if how == "replaced":
                np.save(written.file, 1 - large)

    with pytest.raises(UserError, match=r"label\.npy: was removed or changed while it was written; run again"):
        write_beside()
    assert list(Store(store).drives) == ["a"]


def test_what_is_no_number_is_not_published(store: Path) -> None:
    with pytest.raises(UserError, match="velocity: frame 1 holds what is no finite number"):
        write(store, group="dogma", key="k1", arrays={"velocity": np.where(np.arange(5) == 1, np.nan, VELOCITY.T).T})
    assert not Store(store).drives["a"].has("velocity")
