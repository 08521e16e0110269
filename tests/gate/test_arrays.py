"""Arrays and archives that are not what their schemas say are refused before they cost memory."""

import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.gate import ArraySchema, map_array, read_array, read_arrays
from envpred.gate import arrays as gate

SCHEMAS = {
    "a": ArraySchema("f", ("K", 3), 0, 1),
    "b": ArraySchema("iu", ("K",)),
    "c": ArraySchema("U", (), optional=True),
}


def npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def array(shape: str, descr: str = "'<f4'") -> bytes:
    return npy(f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}")


def archive(file: Path, **members: Any) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        for name, values in members.items():
            content = io.BytesIO()
            if not isinstance(values, bytes):
                np.save(content, values, allow_pickle=True)
            out.writestr(f"{name}.npy", values if isinstance(values, bytes) else content.getvalue())
    return file


A, B = np.full((2, 3), 0.5, np.float32), np.arange(2)


def test_what_fits_is_read_in_either_order(tmp_path: Path) -> None:
    file = archive(tmp_path / "x.npz", a=np.asfortranarray(A * [[0], [1]]), b=B, more=np.zeros(3))
    found = read_arrays(file, SCHEMAS, "again")
    assert list(found) == ["a", "b"]
    np.testing.assert_array_equal(found["a"], A * [[0], [1]])
    found["a"][0, 0] = 1  # it is the reader's own
    assert list(read_arrays(file, lambda names: {name: ArraySchema("f", None) for name in names[2:]}, "x")) == ["more"]


REFUSED: dict[str, dict[str, Any]] = {
    "holds no array b": {"a": A},
    "a has the type float32": {"a": A, "b": A[:, 0]} | {"a": A.astype("S1")},
    "b has the type object|an array of object": {"a": A, "b": np.array([{}, {}], object)},
    r"a has the shape \(2, 4\)": {"a": np.zeros((2, 4)), "b": B},
    r"b has the shape \(3,\)": {"a": A, "b": np.arange(3)},
    "a holds what is no number": {"a": A * np.nan, "b": B},
    "a holds -0.5 to -0.5, beyond 0 to 1": {"a": -A, "b": B},
    "a is cut short, or too long": {"a": array("(2, 3)"), "b": B},
    "b is cut short, or too long": {"a": A, "b": array("(2,)", "'<i8'") + bytes(17)},
    r"an array of float32\(-2, 3\)": {"a": array("(-2, 3)"), "b": B},
    "damaged": {"a": array("(2, 3", "'|O'"), "b": B},
    "not what belongs there .*magic": {"a": b"hello", "b": B},
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_does_not_fit_is_named(tmp_path: Path, reason: str) -> None:
    members = REFUSED[reason]
    if reason == "a has the type float32":
        reason = r"a has the type \|S1"
    with pytest.raises(UserError, match=rf"x\.npz: .*({reason}).*; again"):
        read_arrays(archive(tmp_path / "x.npz", **members), SCHEMAS, "again")


def test_sizes_that_are_only_told_cost_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A header of terabytes, and zeros by the hundred million that fit into 100 kB."""
    huge = ArraySchema("f", ("N",))
    (tmp_path / "x.npy").write_bytes(array("(1000000000000,)"))
    bomb = archive(tmp_path / "bomb.npz", a=array("(3,)") + bytes(100_000_000))
    np.save(tmp_path / "small.npy", np.zeros(3, np.float32))
    reads: list[Callable[[], object]] = [
        lambda: read_array(tmp_path / "x.npy", huge, "again"),
        lambda: read_arrays(archive(tmp_path / "x.npz", a=array("(1000000000000,)")), {"a": huge}, "again"),
        lambda: read_arrays(bomb, {"a": huge}, "again"),
        lambda: map_array(tmp_path / "x.npy", "<f4", (10**12,), "again"),
        lambda: map_array(tmp_path / "small.npy", "<f4", (4,), "again"),
        lambda: map_array(tmp_path / "small.npy", "<f8", (3,), "again"),
    ]
    for read in reads:
        tracemalloc.start()
        with pytest.raises(UserError, match=r"damaged, or not what belongs there \(.+\); again"):
            read()
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
        tracemalloc.stop()
    monkeypatch.setattr(gate, "LARGEST", 100)
    with pytest.raises(UserError, match="unpacks to more than"):
        read_arrays(archive(tmp_path / "x.npz", a=A, b=B), SCHEMAS, "again")


def test_archives_that_are_none_or_damaged(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"x\.npz: missing; again"):
        read_arrays(tmp_path / "x.npz", SCHEMAS, "again")
    content = archive(tmp_path / "x.npz", a=A, b=B).read_bytes()
    for damaged in (b"", content[:-30], content[:60] + b"\xff" + content[61:], content.replace(b"b.npy", b"a.npy")):
        (tmp_path / "x.npz").write_bytes(damaged)
        with pytest.raises(UserError, match=r"x\.npz: damaged, or not what belongs there \(.+\); again"):
            read_arrays(tmp_path / "x.npz", SCHEMAS, "again")
