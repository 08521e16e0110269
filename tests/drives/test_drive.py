"""What every drive has: a period, stretches without a gap, a car and a sensor."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.drives import Drive, find_drives
from envpred.errors import UserError
from envpred.mapping.geometry import PAPER_SENSOR_OFFSET, Body
from tests.drives.synthetic import write_drive, write_sequence


class Stamped(Drive):
    """A drive that has nothing but frame numbers and stamps."""

    name = "stamped"

    def __init__(self, stamps: dict[int, float]) -> None:
        self.stamps = stamps

    @property
    def frames(self) -> list[int]:
        return list(self.stamps)

    def scan(self, k: int) -> NDArray[np.float32]:
        return np.zeros((0, 4), np.float32)

    def pose(self, k: int) -> NDArray[np.float64]:
        return np.eye(4)

    def time(self, k: int) -> float:
        return self.stamps[k]


def test_period_is_that_of_the_stamps_between_neighbours() -> None:
    assert Stamped({k: 0.1035 * k for k in range(9)}).period == 0.1
    assert Stamped({k: 0.05 * k for k in range(9)}).period == 0.05
    # More steps over a missing frame than without one.
    assert Stamped({k: 0.05 * k for k in (0, 1, 3, 5, 7, 9)}).period == 0.05
    assert Stamped({4: 0.0}).period == 0.1


def test_a_missing_number_or_a_long_step_is_a_gap() -> None:
    stamps = {0: 0.0, 1: 0.1, 2: 0.2, 4: 0.4, 5: 0.5, 6: 0.66, 7: 0.76}
    assert Stamped(stamps).stretches() == [(0, 3), (3, 2), (5, 2)]
    assert Stamped({**stamps, 6: 0.6, 7: 0.64}).stretches() == [(0, 3), (3, 3), (6, 1)]  # too short a step
    assert Stamped({4: 0.0}).stretches() == [(0, 1)]


def test_time_that_stands_still_is_one_line() -> None:
    with pytest.raises(UserError, match="stamped: frame 3 has no later time than frame 2; mend"):
        Stamped({1: 0.0, 2: 0.1, 3: 0.1}).stretches()


def test_car_and_sensor_are_kittis_unless_a_reader_says_otherwise(tmp_path: Path) -> None:
    plain = Stamped({0: 0.0})
    assert (plain.body, plain.sensor_height) == (Body(-0.81, 1.95, 0.8), 1.73)
    np.testing.assert_array_equal(plain.sensor_to_body(), PAPER_SENSOR_OFFSET)
    drives = find_drives(write_drive(tmp_path / "raw")) + find_drives(write_sequence(tmp_path / "odometry"))
    assert [(drive.body, drive.sensor_height, drive.period) for drive in drives] == [(plain.body, 1.73, 0.1)] * 2


def test_a_body_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(ValueError, match="its rear behind its front"):
        Body(rear=2.0, front=-1.0)
