"""Soft IoU."""

import pytest
import torch

from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.metrics.soft_iou import soft_iou


def test_by_hand() -> None:
    forecast = torch.tensor([[[[0.8, 0.2, 0.4, 0.9, 0.9]]]])
    label = torch.tensor([[[[OCCUPIED, OCCUPIED, FREE, UNKNOWN, EGO]]]], dtype=torch.uint8)
    assert soft_iou(forecast, label).item() == pytest.approx(1.0 / (1.4 + 2 - 1.0))
    assert soft_iou(torch.zeros_like(forecast), label).item() == 0
    assert soft_iou(forecast, torch.full_like(label, FREE)).item() == 0
    assert soft_iou(torch.zeros_like(forecast), torch.full_like(label, FREE)).isnan().all()


def test_it_rewards_overconfidence() -> None:
    """Half of the cells are occupied, which nobody can tell apart: to say so scores less than to say all are."""
    label = torch.tensor([[[[OCCUPIED, FREE]]]], dtype=torch.uint8)
    honest, sure = (soft_iou(torch.full((1, 1, 1, 2), p), label).item() for p in (0.5, 1.0))
    assert honest == pytest.approx(1 / 3)
    assert sure == pytest.approx(1 / 2)
