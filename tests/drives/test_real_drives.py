"""The real drives through our own code meet the numbers of the paper's reference code."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.build.grids import mapped, mapper_of
from envpred.drives import find_drives
from envpred.mapping.evidence import accumulate, pignistic
from envpred.mapping.mapper import MappingParameters

DRIVES = ["0005", "0013"]
GIVEN, WINDOW = 5, 20
HORIZONS = [1, 5, 10, 15]

# Shares of unknown, occupied, free, ego; static baseline, MSE x 1e-3 at 0.1, 0.5, 1.0, 1.5 s; points left after
# ground removal, least, median, most.
SHARES = {"0005": [0.6454, 0.1041, 0.2463, 0.0043], "0013": [0.4103, 0.0699, 0.5155, 0.0043]}
STATIC = {"0005": [39.41, 110.6, 150.2, 160.4], "0013": [32.43, 52.92, 62.62, 68.64]}
LEFT = {"0005": [39_580, 53_154, 71_852], "0013": [25_563, 35_009, 61_817]}

Labels = dict[str, NDArray[np.uint8]]


@cache
def mapping(root: Path, number: str) -> tuple[Labels, NDArray[np.int32], NDArray[np.int64]]:
    """Label grids (T, H, W) with the day's calibration and with the paper's offset, centre cells, obstacle points."""
    [drive] = [drive for drive in find_drives(root) if f"drive_{number}_" in drive.name]
    labels: Labels = {}
    for sensor in ("calibration", "paper"):
        frames = list(mapped(drive, mapper_of(drive, MappingParameters(sensor=sensor))))
        labels[sensor] = np.stack([frame.label for frame in frames])
    cells = np.stack([frame.centre_cell for frame in frames])
    return labels, cells, np.array([np.count_nonzero(frame.obstacle) for frame in frames])


@pytest.mark.parametrize("number", DRIVES)
def test_shares_of_the_labels(kitti: Path, number: str) -> None:
    labels, _, _ = mapping(kitti, number)
    shares = np.bincount(labels["calibration"].ravel(), minlength=4) / labels["calibration"].size
    assert shares == pytest.approx(SHARES[number], abs=0.005)


@pytest.mark.parametrize("number", DRIVES)
@pytest.mark.parametrize(("sensor", "least"), [("calibration", 0.985), ("paper", 0.995)])
def test_labels_cell_by_cell(kitti: Path, shared: Path, number: str, sensor: str, least: float) -> None:
    labels, cells, _ = mapping(kitti, number)
    reference = np.load(shared / "reference" / f"label_grids_{number}.npz")
    assert (np.diff(cells, axis=0) == np.diff(reference["centre_cell"], axis=0)).all()
    assert (labels[sensor] == reference["labels"]).mean() >= least


@pytest.mark.parametrize("number", DRIVES)
def test_static_baseline(kitti: Path, number: str) -> None:
    labels, cells, _ = mapping(kitti, number)
    probability = pignistic(accumulate(labels["calibration"], cells))
    starts = range(0, len(probability) - WINDOW + 1, WINDOW)
    assert len(starts) == 7
    last = GIVEN - 1
    errors = [[np.mean((probability[s + last + h] - probability[s + last]) ** 2) for h in HORIZONS] for s in starts]
    assert 1e3 * np.mean(errors, axis=0) == pytest.approx(STATIC[number], rel=0.03)


@pytest.mark.parametrize("number", DRIVES)
def test_points_left_after_ground_removal(kitti: Path, number: str) -> None:
    _, _, left = mapping(kitti, number)
    assert [left.min(), np.median(left), left.max()] == pytest.approx(LEFT[number], rel=0.03)
