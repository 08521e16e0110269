"""Muon: its updates are orthogonal, its AdamW half is AdamW, and both go on from a saved state."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.networks.muon import Muon, orthogonal


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 20), st.integers(2, 20), st.integers(0, 1000))
def test_singular_values_end_near_one(rows: int, columns: int, seed: int) -> None:
    matrix = torch.randn(rows, columns, generator=torch.Generator().manual_seed(seed))
    u, values, v = torch.linalg.svd(matrix, full_matrices=False)
    matrix = u @ torch.diag(values.clamp(min=0.2 * float(values[0]))) @ v  # what is far smaller takes more steps
    found = orthogonal(matrix)
    assert found.shape == matrix.shape
    assert ((torch.linalg.svdvals(found) - 0.95).abs() < 0.35).all()
    assert ((found - u @ v).norm() / (u @ v).norm()) < 0.35


def test_what_has_one_dimension_goes_by_adamw() -> None:
    ours, theirs = (torch.tensor([1.0, -2.0, 3.0], requires_grad=True) for _ in range(2))
    muon = Muon([], [ours], others_lr=0.1, weight_decay=0.01)
    adam = torch.optim.AdamW([theirs], 0.1, (0.9, 0.99), 1e-8, 0.01)
    for _ in range(5):
        for parameter, optimizer in ((ours, muon), (theirs, adam)):
            optimizer.zero_grad()
            (parameter**2).sum().backward()  # type: ignore[no-untyped-call]
            optimizer.step()
    torch.testing.assert_close(ours, theirs)


def test_it_goes_on_from_its_state() -> None:
    def steps(optimizer: Muon, weight: torch.Tensor, count: int) -> None:
        for _ in range(count):
            optimizer.zero_grad()
            ((weight - 1) ** 2).sum().backward()  # type: ignore[no-untyped-call]
            optimizer.step()

    first, second = (torch.zeros(4, 3, requires_grad=True) for _ in range(2))
    whole, part = Muon([first], [], 0.05), Muon([second], [], 0.05)
    steps(whole, first, 6)
    steps(part, second, 3)
    rest = Muon([second], [], 0.05)
    rest.load_state_dict(part.state_dict())
    steps(rest, second, 3)
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    assert (first - 1).norm() < (torch.zeros(4, 3) - 1).norm()


def test_the_learning_rate_is_the_length_of_a_step() -> None:
    weight = torch.zeros(4, 4, requires_grad=True)
    optimizer = Muon([weight], [], 0.1, weight_decay=0.0)
    (weight @ torch.eye(4) * torch.randn(4, 4, generator=torch.Generator().manual_seed(0))).sum().backward()  # type: ignore[no-untyped-call]
    optimizer.step()
    assert float(weight.detach().norm()) == pytest.approx(0.1 * 2, rel=0.35)  # four singular values near 0.1
