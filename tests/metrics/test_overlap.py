"""IoU, precision and recall at 0.5."""

import pytest
import torch

from envpred.metrics.overlap import IoU, Precision, Recall
from tests.metrics.labels import labelled


def test_by_hand() -> None:
    # said 3, was 4, both 2; the third cell was not measured
    forecast = torch.tensor([[[[0.9, 0.6, 0.7, 0.2, 0.1, 0.5, 0.8]]]])
    target = torch.tensor([[[[0.9, 0.9, 0.5, 0.8, 0.6, 0.0, 0.1]]]])
    expected = ((IoU, 2 / 5), (Precision, 2 / 3), (Recall, 2 / 4))
    for kind, value in expected:
        metric = kind(1)
        metric.update(forecast, target, label=labelled(target))
        assert metric.compute().mean.item() == pytest.approx(value)


def test_undefined_without_such_cells() -> None:
    nothing, something = torch.full((1, 1, 1, 3), 0.5), torch.full((1, 1, 1, 3), 0.9)
    iou, precision, recall = IoU(1), Precision(1), Recall(1)
    for metric in (iou, precision, recall):
        metric.update(nothing, nothing, label=labelled(nothing))
        metric.update(something, something, label=labelled(something))
    for metric in (iou, precision, recall):
        result = metric.compute()
        assert result.per_window[0].isnan().all()
        assert result.mean.item() == 1.0


def test_precision_and_recall_are_not_swapped() -> None:
    nothing, something = torch.zeros(1, 1, 1, 3), torch.ones(1, 1, 1, 3)
    precision, recall = Precision(1), Recall(1)
    precision.update(nothing, something, label=labelled(something))
    recall.update(nothing, something, label=labelled(something))
    assert precision.compute().mean.isnan().all()
    assert recall.compute().mean.item() == 0.0
