"""Reading a store: what is in it is whole, and what is damaged, foreign or of other parameters is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from envpred.cli.commands import verify
from envpred.errors import UserError
from envpred.mapping.geometry import Body, GridSpec
from envpred.store import FORMAT, MANIFEST, Store, StoredDrive, digest
from tests.store.small import PARAMETERS, VELOCITY, label, write
from tests.store.stores import write_store


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write(tmp_path / "grids")
    return tmp_path / "grids"


def test_round_trip(store: Path) -> None:
    drive = Store(store).drives["a"]
    np.testing.assert_array_equal(drive.array("label"), label())
    np.testing.assert_array_equal(drive.array("time"), np.arange(5.0))
    assert drive.array("label").dtype == np.uint8
    assert drive.frames == [3, 4, 5, 8, 9]
    assert drive.stretches == [(0, 3), (3, 2)]
    np.testing.assert_array_equal(drive.origin, [1.5, -2.0])
    assert (drive.grid, drive.context) == (GridSpec(8), None)  # whatever the manifest says of a grid that is not there
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
    with pytest.raises(UserError, match=r"a/label\.npy: damaged, .*; delete .*/a and run"):
        StoredDrive(store / "a").array("label")


def test_missing_array_is_an_error_that_names_it(store: Path) -> None:
    (store / "a" / "label.npy").unlink()
    with pytest.raises(UserError, match=r"a/label\.npy: missing"):
        StoredDrive(store / "a").verify()


def test_array_of_another_shape_is_refused(store: Path) -> None:
    np.save(store / "a" / "label.npy", label()[:3])
    with pytest.raises(UserError, match=r"label\.npy: damaged, .*uint8\(3, 8, 8\) is not what its manifest says"):
        StoredDrive(store / "a").array("label")


def test_array_outside_its_drive_is_not_read(store: Path) -> None:
    manifest = json.loads((store / "a" / MANIFEST).read_text())
    manifest["arrays"]["label"]["file"] = "../label.npy"
    (store / "a" / "label.npy").rename(store / "label.npy")
    (store / "a" / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(UserError, match=r"a/manifest\.json: names '\.\./label\.npy'"):
        Store(store).drives["a"].array("label")


def test_pickled_array_is_not_loaded(store: Path) -> None:
    np.save(store / "a" / "label.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(UserError, match="damaged, or not what belongs there"):
        StoredDrive(store / "a").array("label")


def test_array_that_was_never_made_names_the_command(store: Path) -> None:
    with pytest.raises(UserError, match=r"no array 'velocity'; build it with `envpred grids"):
        StoredDrive(store / "a").array("velocity")


@pytest.mark.parametrize("content", ["", "{", "[]", "null"])
def test_damaged_manifest_is_named(store: Path, content: str) -> None:
    (store / "a" / MANIFEST).write_text(content)
    with pytest.raises(UserError, match=r"a/manifest\.json: (cannot be read as JSON|format None)"):
        _ = StoredDrive(store / "a").manifest


@pytest.mark.parametrize("file", ["store.json", "a/manifest.json"])
def test_other_format_is_refused(store: Path, file: str) -> None:
    content = json.loads((store / file).read_text())
    (store / file).write_text(json.dumps({**content, "format": 99}))
    with pytest.raises(UserError, match=rf"{file}: format 99, this version reads {FORMAT}"):
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


def test_the_tests_own_store_has_both_grids(tmp_path: Path) -> None:
    drive = Store(write_store(tmp_path, {"a": [0, 1, 2]}, cells=8, context=16, period=0.05)).drives["a"]
    assert (drive.grid.cells, drive.context, drive.period) == (8, GridSpec(16), 0.05)
    np.testing.assert_array_equal(drive.array("context_label")[:, 4:-4, 4:-4], drive.array("label"))
    assert drive.array("context_evidence").shape == (3, 2, 16, 16)


@pytest.mark.parametrize("times", [1, 2])  # once its files have other names, twice the same again
def test_what_is_built_again_while_it_is_read_is_told(store: Path, times: int) -> None:
    drive = Store(store).drives["a"]
    mapped = drive.array("label")
    for seed in range(1, times + 1):
        write(store, key="k2", arrays={"label": label(seed), "time": np.arange(5.0)})
    np.testing.assert_array_equal(mapped, label())  # what is open stays as it was
    with pytest.raises(UserError, match=r"a: 'label' was built again while it was read; run this command again"):
        drive.array("label")
    np.testing.assert_array_equal(Store(store).drives["a"].array("label"), label(times))


def test_what_is_added_while_a_drive_is_read_does_not_matter(store: Path) -> None:
    drive = Store(store).drives["a"]
    drive.array("label")
    write(store, group="dogma", key="k1", arrays={"velocity": VELOCITY})
    np.testing.assert_array_equal(drive.array("label"), label())
