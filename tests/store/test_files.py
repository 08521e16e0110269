"""Files that are replaced in one step or not at all, and plain data with dotted names."""

import json
import threading
from pathlib import Path

import pytest

from envpred.errors import UserError
from envpred.store.files import digest, flat, inside, replace_text, replaced, write_json


def test_a_file_is_replaced_when_it_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "picture.png"
    file.write_text("old")
    with replaced(file) as part:
        assert part.suffix == ".png"  # libraries go by it
        part.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    assert list(tmp_path.iterdir()) == [file]


def test_what_fails_halfway_leaves_the_old_file_alone(tmp_path: Path) -> None:
    file = tmp_path / "curve.npz"
    file.write_text("old")

    def fail() -> None:
        with replaced(file) as part:
            part.write_text("ha")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_json_that_cannot_be_written_leaves_the_old(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"a": object()})
    assert (tmp_path / "a.json").read_text() == json.dumps({"a": 1}, indent=1)


def test_digest_does_not_depend_on_the_order_of_keys() -> None:
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1}) != digest({"a": 2, "b": 1})


def test_nested_names_are_dotted() -> None:
    assert flat({"a": {"b": {"c": 1}, "d": [2, {"e": 3}]}, "f": None}) == {"a.b.c": 1, "a.d": [2, {"e": 3}], "f": None}
    assert flat({"a": {}, "b": {"c": {}}}) == {"a": {}, "b.c": {}}  # an empty mapping is a value, not nothing
    assert flat({}) == {}


def test_a_replaced_file_is_the_old_one_or_the_new_one(tmp_path: Path) -> None:
    file, texts = tmp_path / "file", ("a" * 100_000, "b" * 50_000)
    replace_text(file, texts[0])
    done = threading.Event()

    def write() -> None:
        for k in range(100):
            replace_text(file, texts[k % 2])
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    found = set()
    while not done.is_set():
        found.add(file.read_text())
    writer.join()
    assert found <= set(texts)


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "a/../../x", "", ".", "..", "link", "circle", "a\0b", None])
def test_a_name_that_leaves_its_folder_is_refused(tmp_path: Path, name: str | None) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path / "x")
    (folder / "circle").symlink_to(folder / "circle")
    if name is None:
        assert inside(folder, "a/b.png", folder / "result.json") == folder / "a/b.png"
        return
    with pytest.raises(UserError, match=r"result\.json: names .* which does not lie in .*run"):
        inside(folder, name, folder / "result.json")


def test_a_folder_on_another_disk_is_its_own(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    assert inside(tmp_path / "run", "a.npy", tmp_path / "manifest.json") == tmp_path / "run" / "a.npy"
