"""The stores of the real drives are to the bit what they have always been, with a wider grid beside them or without."""

from pathlib import Path

import numpy as np
import pytest

from envpred.build.grids import build
from envpred.store import Store

pytestmark = pytest.mark.usefixtures("no_processes")

# Checksums (CRC-32) of the arrays as they were before drives had periods, cars and wider grids.
BEFORE = {
    "2011_09_26_drive_0005_sync": {
        "label": 665242172,
        "evidence": 3571373449,
        "centre_cell": 1073719030,
        "time": 3950379828,
    },
    "2011_09_26_drive_0013_sync": {
        "label": 3815182057,
        "evidence": 3933501782,
        "centre_cell": 2307377474,
        "time": 2863516065,
    },
}

# Sums of the absolute entries of all poses: their last bits are those of sines and products, far from the origin.
POSES = {"2011_09_26_drive_0005_sync": 6785.1281241700235, "2011_09_26_drive_0013_sync": 15772.056076833005}


@pytest.mark.parametrize("context", [None, 256])
def test_default_mapping_of_the_real_drives(kitti: Path, tmp_path: Path, context: int | None) -> None:
    build(kitti, tmp_path / "grids", context=context)
    for name, expected in BEFORE.items():
        drive = Store(tmp_path / "grids").drives[name]
        assert {array: drive.manifest["arrays"][array]["checksum"] for array in expected} == expected
        assert np.abs(drive.array("pose")).sum() == pytest.approx(POSES[name], abs=1e-6)
        assert drive.has("context_label") == (context is not None)
        assert drive.period == 0.1
