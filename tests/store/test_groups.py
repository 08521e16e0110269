"""Groups of arrays: which there are, what makes them, and when they are stale."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.store import GROUPS, MANIFEST, DriveWriter, Store
from envpred.store.groups import OPTIONS, group_of
from tests.store.small import ABOUT, VELOCITY, label, write
from tests.store.stores import write_store


@pytest.fixture
def store(tmp_path: Path) -> Path:
    drives = {"a": [0, 1, 2], "b": [0, 1]}
    return write_store(tmp_path / "grids", drives, cells=8, dogma=True, context=16, moving="ab")


def test_the_table_says_which_group_an_array_is_of(store: Path) -> None:
    entries = Store(store).drives["a"].manifest["arrays"]
    assert {name: entry["group"] for name, entry in entries.items()} == {name: group_of(name) for name in entries}
    assert sorted(entries) == sorted(array for group in GROUPS.values() for array in group.arrays)
    for group in GROUPS.values():
        importlib.import_module(group.job)
    assert all(group_of(array) for array in OPTIONS)


@pytest.mark.parametrize(
    ("array", "options"),
    [
        ("label", "--source DRIVES"),
        ("context_evidence", "--source DRIVES --context 256"),
        ("velocity", "--dogma"),
        ("particle_forecast", "--particle_forecast all"),
    ],
)
def test_what_is_missing_names_the_command_that_makes_it(tmp_path: Path, array: str, options: str) -> None:
    write(tmp_path, arrays={"depth": np.arange(5.0)})
    with pytest.raises(UserError, match=f"no array '{array}'") as failure:
        Store(tmp_path).check(["a"], [array])
    assert str(failure.value).endswith(f"build it with `envpred grids --store {tmp_path} {options}`")


def test_what_no_group_holds_names_what_there_is(store: Path) -> None:
    with pytest.raises(UserError, match=r"a: holds no array 'depth'; it has label, evidence, "):
        Store(store).check(["a"], ["depth"])


@pytest.mark.parametrize(
    ("group", "array"), [("dogma", "velocity"), ("context", "context_label"), ("mapping", "label")]
)
def test_a_group_of_other_parameters_is_stale_whoever_asks(store: Path, group: str, array: str) -> None:
    every = ["label", "velocity", "context_label"]
    Store(store).check(["a", "b"], every)
    Store(store).claim(group, {"other": 1}, force=True)
    with pytest.raises(UserError, match=rf"the {group} grids of a, b were built with other parameters.*`envpred grids"):
        Store(store).check(["a", "b"], [array])
    if group != "mapping":  # what nobody asks for does not matter
        Store(store).check(["a", "b"], [name for name in every if name != array])
    else:  # what is made of the mapping is no better than it
        with pytest.raises(UserError, match="the mapping grids of a were built"):
            Store(store).check(["a"], ["velocity"])


def test_one_stale_drive_among_many_is_named(store: Path) -> None:
    file = store / "b" / MANIFEST
    manifest = json.loads(file.read_text())
    file.write_text(json.dumps({**manifest, "groups": {**manifest["groups"], "dogma": "another"}}))
    Store(store).check(["a"], ["velocity"])
    with pytest.raises(UserError, match="the dogma grids of b were built"):
        Store(store).check(["a", "b"], ["velocity"])


def test_what_a_drive_lacks(store: Path) -> None:
    keys = {name: Store(store).drives["a"].manifest["groups"][name] for name in ("mapping", "context")}
    assert Store(store).lacking("a", keys) == {}
    assert Store(store).lacking("c", keys) == keys
    assert Store(store).lacking("a", {**keys, "context": "new"}) == {"context": "new"}
    assert Store(store).lacking("a", {**keys, "mapping": "new"}) == {**keys, "mapping": "new"}


def test_two_groups_are_written_in_one_step(tmp_path: Path) -> None:
    write(tmp_path)
    wide = np.zeros((5, 16, 16), np.uint8)
    with DriveWriter(tmp_path, "a", "mapping", "k", ABOUT, {"context": "c"}) as out:
        out.add("label", np.uint8, (5, 8, 8)).extend(label(1))
        out.add("context_label", np.uint8, wide.shape, "context").extend(wide)
    drive = Store(tmp_path).drives["a"]
    drive.verify()
    assert drive.manifest["groups"] == {"mapping": "k", "context": "c"}
    assert drive.manifest["arrays"]["context_label"]["group"] == "context"
    write(tmp_path, group="dogma", key="d", arrays={"velocity": VELOCITY})
    write(tmp_path, key="k2", arrays={"label": label()})
    assert Store(tmp_path).drives["a"].manifest["groups"] == {"mapping": "k2"}
    assert len(list((tmp_path / "a").iterdir())) == 2  # the label grids and the manifest
