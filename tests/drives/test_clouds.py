"""Files of points whose headers promise more than they hold."""

import tracemalloc
from pathlib import Path

import pytest

from envpred.drives.clouds import read_cloud
from envpred.errors import UserError

PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {type}\nCOUNT {count}\n"
    "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {data}\n"
)
XYZ = {"fields": "x y z", "size": "4 4 4", "type": "F F F", "count": "1 1 1", "n": "100", "data": "binary"}
PLY = "ply\nformat {format} 1.0\nelement vertex {n}\n{properties}end_header\n"
VERTEX = {"format": "binary_little_endian", "n": "100", "properties": "".join(f"property float {a}\n" for a in "xyz")}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pcd", PCD.format(**XYZ | {"n": 9_000_000})),
        ("a.pcd", PCD.format(**XYZ | {"n": 10**12})),
        ("a.pcd", PCD.format(**XYZ | {"n": 9_000_000, "data": "ascii"})),
        ("a.pcd", PCD.format(**XYZ | {"count": f"1 1 {10**9}"})),
        ("a.pcd", PCD.format(**XYZ | {"size": "4 4"})),
        ("a.pcd", PCD.format(**XYZ | {"data": "binary_compressed"}) + "\xff\xff\xff\x3f" * 2),
        ("a.pcd", PCD.format(**XYZ | {"fields": "a b c"}) + "\0" * 1200),
        ("a.pcd", "VERSION 0.7\n" * 10_000),
        ("a.ply", PLY.format(**VERTEX | {"n": 9_000_000})),
        ("a.ply", PLY.format(**VERTEX | {"n": 10**12})),
        ("a.ply", PLY.format(**VERTEX | {"n": 9_000_000, "format": "ascii"})),
        ("a.ply", PLY.format(**VERTEX | {"properties": "property list uint int x\n"}) + "\xff" * 1200),
        ("a.ply", PLY.format(**VERTEX | {"properties": "property float a\n"}) + "\0" * 1200),
        ("a.ply", "ply\n" * 30_000),
    ],
)
def test_a_header_that_promises_too_much_costs_nothing(tmp_path: Path, name: str, content: str) -> None:
    file = tmp_path / name
    file.write_bytes(content.encode("latin-1"))
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=rf"{name}: ") as failure:
            read_cloud(file)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    assert "\n" not in str(failure.value)
