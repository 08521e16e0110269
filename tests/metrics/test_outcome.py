"""What happened in a cell, and that metrics judge by nothing else."""

from pathlib import Path

import numpy as np
import pytest
import torch

from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.metrics.calibration import Calibration, Reliability
from envpred.metrics.collection import forecast_metrics
from envpred.metrics.outcome import histograms, measured, occupied
from envpred.metrics.windows import PerHorizon, WindowMetric
from tests.metrics.labels import labelled


def test_codes() -> None:
    label = torch.tensor([UNKNOWN, OCCUPIED, FREE, EGO], dtype=torch.uint8)
    assert occupied(label).tolist() == [False, True, False, False]
    assert measured(label).tolist() == [False, True, True, False]


def test_histograms_by_hand() -> None:
    label = torch.tensor([[OCCUPIED, FREE, FREE, UNKNOWN], [EGO, FREE, OCCUPIED, OCCUPIED]], dtype=torch.uint8)
    place = torch.tensor([[0, 1, 1, 0], [2, 2, 2, 0]], dtype=torch.int32)
    weights = torch.tensor([[0.5, 0.25, 0.5, 9.0], [9.0, 1.0, 2.0, 3.0]])
    free, full = histograms(place[None, :, None], label[None, :, None], 3)
    assert free.tolist() == [[[0, 2, 0], [0, 0, 1]]]
    assert full.tolist() == [[[1, 0, 0], [1, 0, 1]]]
    free, full = histograms(place[None, :, None], label[None, :, None], 3, weights[None, :, None])
    assert free.tolist() == [[[0, 0.75, 0], [0, 0, 1]]]
    assert full.tolist() == [[[0.5, 0, 0], [3, 0, 2]]]


def by_label(label: torch.Tensor, forecast: torch.Tensor) -> dict[str, list[float]]:
    """What the metrics that need labels say, of targets that say nothing."""
    found: dict[str, list[float]] = {}
    for metric in forecast_metrics(label.shape[1]).values():
        assert isinstance(metric, WindowMetric)
        if metric.needs_label:
            metric.update(forecast, torch.full_like(forecast, 0.5), forecast[:, 0], label=label)
            results = metric.compute()
            results = {metric.name: results} if isinstance(results, PerHorizon) else results
            found |= {name: result.as_json().get("mean") for name, result in results.items()}
    return found


def test_nothing_but_measured_cells_is_judged() -> None:
    """Whatever is forecast where nothing was measured, the outcomes stay the same; and one cell more matters to all."""
    generator = torch.Generator().manual_seed(1)
    forecast, other, drawn = torch.rand(3, 2, 3, 12, 12, generator=generator)
    label = torch.randint(0, 4, forecast.shape, generator=generator, dtype=torch.uint8)
    was = (label == OCCUPIED) | (label == FREE)
    found = by_label(label, forecast)
    expected = {"brier", "log_score", "ece", "roc_auc", "pr_auc", "iou", "precision", "recall", "soft_iou"}
    assert found.keys() >= expected | {"fractions_skill"}
    assert by_label(label, forecast.where(was, other)) == found
    elsewhere = by_label(label, forecast.where(~was, other))
    assert all(elsewhere[name] != found[name] for name in expected | {"fractions_skill"})
    assert by_label(labelled(drawn).where(was, label), forecast) != found


def test_labels_are_asked_for() -> None:
    target = torch.zeros(1, 1, 2, 2)
    for metric in forecast_metrics(1).values():
        assert isinstance(metric, WindowMetric)
        if metric.needs_label:
            with pytest.raises(ValueError, match=f"{type(metric).__name__} needs `label`, what was measured"):
                metric.update(target, target, target[:, 0])


def test_every_cell_that_is_judged_of_a_real_drive_was_measured(shared: Path) -> None:
    """Half of what the map remembers as occupied was not, which is why memory is no outcome."""
    held = np.load(shared / "reference/evidence_0005.npz")
    label = torch.from_numpy(held["labels"])[5:20][None]
    target = torch.from_numpy(held["probability"])[5:20][None]
    was = (label == OCCUPIED) | (label == FREE)
    metric = Calibration()
    metric.update(target, target, label=label)
    diagram = metric.compute()["reliability"]
    assert isinstance(diagram, Reliability)
    assert diagram.count.sum(1).tolist() == was.sum((0, 2, 3)).tolist()
    shares = (diagram.occupied * diagram.count).nansum(1) / diagram.count.sum(1)
    assert shares.tolist() == pytest.approx(((label == OCCUPIED).sum((0, 2, 3)) / was.sum((0, 2, 3))).tolist())
    assert 0.3 < was[target > 0.5].float().mean() < 0.7
