"""Evidence: a chain by hand, what must always hold, and the reference code's own masses."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.evidence import EvidenceParameters, accumulate, measured, pignistic, step
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN

STILL = np.zeros(2, np.int32)


def grid(*codes: int) -> NDArray[np.uint8]:
    """A label grid (1, W)."""
    return np.array([codes], np.uint8)


def test_a_chain_of_three_frames_by_hand() -> None:
    # One cell seen occupied, then free, then occupied again, beside one that is free, unknown, unknown.
    labels = np.stack([grid(OCCUPIED, FREE), grid(FREE, UNKNOWN), grid(OCCUPIED, UNKNOWN)])
    mass = accumulate(labels, np.zeros((3, 2), np.int32))[:, :, 0]
    # Frame 0: the measurement alone.
    assert mass[0] == pytest.approx(np.array([[0.95, 0], [0, 0.95]]))
    # Frame 1: 0.95 ages to 0.855 (cap 1); K = 0.855 x 0.95 = 0.81225;
    # mO = 0.855 x 0.05 / 0.18775 = 0.227696, mF = 0.145 x 0.95 / 0.18775 = 0.733688.
    assert mass[1, :, 0] == pytest.approx([0.04275 / 0.18775, 0.13775 / 0.18775], abs=1e-6)
    # Frame 2: aged to 0.204927 (cap 0.266312) and 0.660320 (cap 0.772304), ignorance 0.134754; K = 0.660320 x 0.95;
    # mO = (0.204927 x 0.05 + 0.134754 x 0.95 + 0.204927 x 0.95) / 0.372696, mF = 0.660320 x 0.05 / 0.372696.
    assert mass[2, :, 0] == pytest.approx([0.893336, 0.088587], abs=2e-6)
    # What is not seen only ages: 0.95 x 0.9, x 0.9 again.
    assert mass[1:, :, 1] == pytest.approx(np.array([[0, 0.855], [0, 0.7695]]), abs=1e-6)
    assert pignistic(mass[..., None])[0].ravel() == pytest.approx([0.975, 0.025])


def test_the_caps_of_aging_take_the_masses_before_aging() -> None:
    # With little discount and little ignorance left the caps act: 1 - 0.38 = 0.62 and 1 - 0.64 = 0.36.
    prior = np.array([[[0.64]], [[0.38]]], np.float32)  # rounded a little too large together
    aged = step(prior, grid(UNKNOWN), STILL, EvidenceParameters(discount=0.99))
    assert aged.ravel() == pytest.approx([0.62, 0.36], abs=1e-6)


def test_measurement_masses_of_the_four_codes() -> None:
    masses = measured(grid(UNKNOWN, OCCUPIED, FREE, EGO))
    assert masses.shape == (2, 1, 4)
    assert masses[:, 0].tolist() == pytest.approx(np.array([[0, 0.95, 0, 1], [0, 0, 0.95, 0]]))
    assert pignistic(masses)[0] == pytest.approx([0.5, 0.975, 0.025, 1.0])


def test_the_ego_leaves_and_free_space_takes_its_place() -> None:
    mass = accumulate(np.stack([grid(EGO), grid(FREE)]), np.zeros((2, 2), np.int32))
    # m(O) 1 ages to 0.9: K = 0.855, mO = 0.9 x 0.05 / 0.145, mF = 0.1 x 0.95 / 0.145.
    assert mass[1].ravel() == pytest.approx([0.045 / 0.145, 0.095 / 0.145], abs=1e-6)


@pytest.mark.parametrize("discount", [0.9, 1.0])
def test_no_mass_leaves_0_to_1_by_rounding(discount: float) -> None:
    histories = np.array(list(product(range(4), repeat=6)), np.uint8).T[:, None]
    mass = accumulate(histories, np.zeros((6, 2), np.int32), EvidenceParameters(discount=discount))
    assert ((mass >= 0) & (mass <= 1)).all()
    assert pignistic(mass).max() <= 1


def test_certainty_against_certainty_is_settled_by_the_newer() -> None:
    sure = EvidenceParameters(occupied=1, free=1, discount=1)
    mass = accumulate(np.stack([grid(OCCUPIED, FREE), grid(FREE, EGO)]), np.zeros((2, 2), np.int32), sure)
    assert mass[1, :, 0].tolist() == [[0, 1], [1, 0]]


@pytest.mark.parametrize("shift", [(1, 0), (0, 1), (-2, 0), (0, -1), (1, -2), (9, 0), (0, -9)])
def test_a_shift_moves_whole_cells_and_cells_that_enter_are_empty(shift: tuple[int, int]) -> None:
    random = np.random.default_rng(1)
    prior = random.dirichlet((1, 1, 1), (5, 4)).transpose(2, 0, 1)[:2].astype(np.float32)
    moved = step(prior, np.zeros((5, 4), np.uint8), np.array(shift))
    expected = np.zeros_like(prior)
    for i in range(5):
        for j in range(4):
            # The grid moved by `shift`: what is at (i, j) now was at (i, j) + shift.
            source = (i + shift[0], j + shift[1])
            if 0 <= source[0] < 5 and 0 <= source[1] < 4:
                expected[:, i, j] = 0.9 * prior[:, source[0], source[1]]
    assert moved == pytest.approx(expected, abs=1e-6)


codes = st.integers(0, 3)
drives = st.integers(1, 6).flatmap(
    lambda frames: st.tuples(
        st.lists(st.lists(codes, min_size=12, max_size=12), min_size=frames, max_size=frames),
        st.lists(st.tuples(st.integers(-2, 2), st.integers(-2, 2)), min_size=frames, max_size=frames),
        st.sampled_from([0.0, 0.5, 0.9, 1.0]),
    )
)


@settings(max_examples=60, deadline=None)
@given(drives)
def test_masses_stay_valid_and_a_drive_is_its_steps(
    drive: tuple[list[list[int]], list[tuple[int, int]], float],
) -> None:
    labels = np.array(drive[0], np.uint8).reshape(-1, 3, 4)
    centre_cell = np.cumsum(drive[1], axis=0).astype(np.int32) + 500
    parameters = EvidenceParameters(discount=drive[2])
    mass = accumulate(labels, centre_cell, parameters)
    assert mass.dtype == np.float32
    assert ((mass >= 0) & (mass <= 1)).all()
    assert (mass.sum(axis=1) <= 1 + 2e-7).all(), "but for rounding"
    probability = pignistic(mass)
    assert ((probability >= 0) & (probability <= 1)).all()
    assert (mass == accumulate(labels, centre_cell + 77, parameters)).all(), "only differences of centre_cell matter"
    prior = np.zeros((2, 3, 4), np.float32)
    for t in range(len(labels)):
        shift = centre_cell[t] - centre_cell[t - 1] if t else STILL
        prior = step(prior, labels[t], shift, parameters)
        assert (mass[t] == prior).all()


def test_what_is_measured_again_and_again_becomes_surer() -> None:
    mass = accumulate(np.full((5, 1, 1), OCCUPIED, np.uint8), np.zeros((5, 2), np.int32))[:, 0, 0, 0]
    assert (np.diff(mass) > 0).all()
    assert mass[-1] < 1


def test_masses_and_probability_of_the_reference(shared: Path) -> None:
    reference = np.load(shared / "reference" / "evidence_0005.npz")
    mass = accumulate(reference["labels"], reference["centre_cell"])
    assert np.abs(mass - reference["mass"]).max() < 1e-5
    assert np.abs(pignistic(mass) - reference["probability"]).max() < 1e-5


@pytest.mark.parametrize(("labels", "cells"), [((3, 4), (3, 2)), ((3, 4, 4), (2, 2)), ((3, 4, 4), (3, 3))])
def test_shapes_that_do_not_belong_together_are_refused(labels: tuple[int, ...], cells: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"\(T,H,W\)"):
        accumulate(np.zeros(labels, np.uint8), np.zeros(cells, np.int32))


@pytest.mark.parametrize(
    ("prior", "label", "shift"),
    [((2, 4, 4), (4, 5), 2), ((1, 4, 4), (4, 4), 2), ((2, 4), (4,), 2), ((2, 4, 4), (4, 4), 1)],
)
def test_a_step_refuses_what_does_not_fit(prior: tuple[int, ...], label: tuple[int, ...], shift: int) -> None:
    with pytest.raises(ValueError, match=r"\(2,H,W\)"):
        step(np.zeros(prior, np.float32), np.zeros(label, np.uint8), np.zeros(shift, np.int32))


@pytest.mark.parametrize("name", ["occupied", "free", "ego", "discount"])
def test_masses_outside_0_to_1_are_refused(name: str) -> None:
    for value in (-0.1, 1.1, float("nan")):
        with pytest.raises(UserError, match=name):
            EvidenceParameters(**{name: value})
