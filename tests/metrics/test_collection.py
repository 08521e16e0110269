"""The set of metrics, on real evidence and as a whole."""

import doctest
import importlib
import json
import pkgutil
from pathlib import Path

import numpy as np
import pytest
import torch

import envpred.metrics
from envpred.metrics.collection import forecast_metrics

NAMES = {
    *(
        "mse",
        "mse_dynamic_cells",
        "mse_static_cells",
        "skill",
        "iou",
        "precision",
        "recall",
        "roc_auc",
        "brier",
        "motion_ratio",
    ),
    *("image_similarity", "image_similarity_occupied", "image_similarity_free", "image_similarity_unknown"),
    *("ece", "reliability"),
}


def test_names_and_json() -> None:
    generator = torch.Generator().manual_seed(0)
    metrics = forecast_metrics(3)
    target = torch.rand(2, 3, 8, 8, generator=generator)
    metrics.update(target, target, target[:, 0], torch.arange(2))
    result = metrics.compute()
    assert set(result) == NAMES
    text = json.dumps({name: value.as_json() for name, value in result.items()}, allow_nan=False)
    assert json.loads(text)["mse"] == {
        "mean": [0, 0, 0],
        "standard_error": [0, 0, 0],
        "per_window": [[0, 0, 0], [0, 0, 0]],
    }


def test_metrics_that_agree_on_the_first_window_stay_apart() -> None:
    target = torch.tensor([[[[0.9, 0.1, 0.9]]]])
    metrics = forecast_metrics(1)
    metrics.update(target, target, target[:, 0])
    metrics.update(torch.tensor([[[[0.9, 0.9, 0.1]]]]), target, target[:, 0])
    result = metrics.compute()
    assert result["iou"].mean.item() == pytest.approx((1 + 1 / 3) / 2)
    assert result["precision"].mean.item() == pytest.approx((1 + 1 / 2) / 2)


def test_the_static_forecast_of_a_real_drive(shared: Path) -> None:
    probability = torch.from_numpy(np.load(shared / "reference/evidence_0005.npz")["probability"]).float()
    target, last = probability[5:20][None], probability[4][None]
    metrics = forecast_metrics()
    metrics.update(last[:, None].expand_as(target), target, last)
    result = metrics.compute()
    expected = ((probability[5:20] - probability[4]) ** 2).double().mean((1, 2))
    torch.testing.assert_close(result["mse"].mean, expected, rtol=1e-5, atol=0)
    assert (result["motion_ratio"].mean == 0).all()
    assert (result["skill"].value == 0).all()
    assert (result["mse_dynamic_cells"].mean > 5 * result["mse_static_cells"].mean).all()
    similarity = result["image_similarity"].mean
    assert similarity[0] < similarity[4] < similarity[14]
    parts = [result[f"image_similarity_{name}"].mean for name in ("occupied", "free", "unknown")]
    torch.testing.assert_close(sum(parts), similarity)
    assert result["iou"].mean[0] > result["iou"].mean[14]


@pytest.mark.parametrize("name", [module.name for module in pkgutil.iter_modules(envpred.metrics.__path__)])
def test_examples_in_docstrings(name: str) -> None:
    assert doctest.testmod(importlib.import_module(f"envpred.metrics.{name}")).failed == 0
