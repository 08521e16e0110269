"""The time between frames, by hand, and what numbers per frame become at another one."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from envpred.mapping import evidence
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import FREE, OCCUPIED, UNKNOWN
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.mapping.period import is_gap, nominal


@pytest.mark.parametrize(
    ("steps", "period"),
    [
        ([0.1035, 0.1033, 0.1036, 0.31], 0.1),  # KITTI's scanner turns a little slower than 10 Hz
        ([0.05, 0.0501, 0.0499], 0.05),
        ([0.5], 0.5),
        ([0.207, 0.207], 0.2),
        ([1.4, 1.4], 1.4),  # 0.71 Hz is no whole number of Hz
        ([0.135] * 3, 0.135),  # 7.4 Hz: 7 Hz are more than 5 % away
        ([], 0.1),
    ],
)
def test_period_of_stamps(steps: list[float], period: float) -> None:
    assert nominal(np.array(steps)) == period


def test_half_a_period_more_or_less_is_a_gap() -> None:
    assert [is_gap(step, 0.1) for step in (0.04, 0.06, 0.1, 0.14, 0.16, -0.1)] == [
        True,
        False,
        False,
        False,
        True,
        True,
    ]


def test_the_papers_period_changes_no_bit() -> None:
    assert EvidenceParameters().at(0.1) == EvidenceParameters()
    assert ParticleFilterParameters().at(0.1) == ParticleFilterParameters()
    assert GROUND.at(0.1) is GROUND


def fade(period: float) -> np.ndarray:
    """Masses (2, 2) of a cell seen occupied and one seen free, after a second in which neither was seen."""
    labels = np.full((1 + round(1 / period), 1, 2), UNKNOWN, np.uint8)
    labels[0, 0] = OCCUPIED, FREE
    still = np.zeros((len(labels), 2), np.int32)
    return evidence.accumulate(labels, still, EvidenceParameters().at(period))[-1, :, 0]


@pytest.mark.parametrize("period", [0.05, 0.2])
def test_masses_fade_as_fast_in_time_at_any_period(period: float) -> None:
    np.testing.assert_allclose(fade(period), fade(0.1), atol=1e-6)
    assert fade(0.1)[0, 0] == pytest.approx(0.95 * 0.9**10, abs=1e-6)


@pytest.mark.parametrize("numbers", [ParticleFilterParameters(), GROUND])
@pytest.mark.parametrize(("period", "steps"), [(0.05, 2), (0.1 / 3, 3)])
def test_so_many_short_steps_do_what_one_of_the_paper_does(
    numbers: ParticleFilterParameters, period: float, steps: int
) -> None:
    short = numbers.at(period)
    assert short.discount**steps == pytest.approx(numbers.discount)
    assert short.survival**steps == pytest.approx(numbers.survival)
    assert 1 - (1 - short.birth) ** steps == pytest.approx(numbers.birth)
    assert steps * short.position_noise**2 == pytest.approx(numbers.position_noise**2)
    assert steps * short.velocity_noise**2 == pytest.approx(numbers.velocity_noise**2)
    assert short.matching * short.period == pytest.approx(numbers.matching * numbers.period)
    scaled = ("period", "discount", "survival", "birth", "position_noise", "velocity_noise", "matching")
    others = {name: value for name, value in asdict(short).items() if name not in scaled}
    assert others == {name: value for name, value in asdict(numbers).items() if name not in scaled}
    back = short.at(0.1)
    assert asdict(back) == pytest.approx(asdict(numbers))


def test_matching_never_compares_a_grid_with_itself() -> None:
    assert replace(GROUND, matching=1).at(0.4).matching == 1
