"""The set of metrics, on real evidence and as a whole."""

import doctest
import importlib
import json
import pkgutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import envpred.metrics
from envpred.errors import UserError
from envpred.metrics.cells import KINDS
from envpred.metrics.collection import forecast_metrics
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.roc_auc import RocAuc
from envpred.metrics.windows import HorizonMetric, PerHorizon
from tests.metrics.labels import labelled

TITLES = {
    "mse": ("MSE", "lower"),
    "mse_occupied_mass": ("MSE against the mass of occupied", "lower"),
    "mse_changed_cells": ("MSE, changed cells", "lower"),
    "mse_static_cells": ("MSE, static cells", "lower"),
    "mse_moving_cells": ("MSE, moving cells", "lower"),
    "mse_entering_cells": ("MSE, entering cells", "lower"),
    "skill": ("Skill against the static baseline", "higher"),
    "iou": ("IoU at 0.5", "higher"),
    "precision": ("Precision at 0.5", "higher"),
    "recall": ("Recall at 0.5", "higher"),
    "soft_iou": ("Soft IoU", "higher"),
    "fractions_skill": ("Fractions skill, 5 × 5 cells", "higher"),
    "roc_auc": ("ROC area", "higher"),
    "pr_auc": ("Precision-recall area", "higher"),
    "brier": ("Brier score", "lower"),
    "log_score": ("Log score, smoothed by 0.01", "lower"),
    "motion_ratio": ("Motion ratio", 1.0),
    "image_similarity": ("Image similarity", "lower"),
    "image_similarity_occupied": ("Image similarity, occupied", "lower"),
    "image_similarity_free": ("Image similarity, free", "lower"),
    "image_similarity_unknown": ("Image similarity, unknown", "lower"),
    "ece": ("Calibration error", "lower"),
    "crps": ("CRPS", "lower"),
    "spread_skill": ("Spread over skill", 1.0),
    "mse_best_of_k": ("MSE, best of 16", "lower"),
}
for whole in ("brier", "log_score", "ece", "crps", "spread_skill", "mse_best_of_k"):
    title, direction = TITLES[whole]
    TITLES |= {f"{whole}_{kind}_cells": (f"{title}, {kind} cells", direction) for kind in KINDS}
NAMES = {*TITLES, "reliability"}


def test_names_and_json() -> None:
    generator = torch.Generator().manual_seed(0)
    metrics = forecast_metrics(3)
    target = torch.rand(2, 3, 8, 8, generator=generator)
    metrics.update(target, target, target[:, 0], torch.arange(2), label=labelled(target))
    result = metrics.compute()
    assert set(result) == NAMES
    written = json.loads(json.dumps({name: value.as_json() for name, value in result.items()}, allow_nan=False))
    values = {"mean": [0, 0, 0], "standard_error": [0, 0, 0], "per_window": [[0, 0, 0], [0, 0, 0]]}
    assert {key: written["mse"][key] for key in values} == values
    assert {name: (told["title"], told["direction"]) for name, told in written.items() if "mean" in told} == TITLES
    assert all(told["rewards"].startswith("Rewards ") for told in written.values() if "mean" in told)
    thousandths = {name for name in TITLES if name.startswith(("mse", "crps"))}
    assert {name: told["factor"] for name, told in written.items() if "mean" in told} == {
        name: 1e3 if name in thousandths else 1.0 for name in TITLES
    }
    assert {name for name, told in written.items() if told.get("unit") == "× 10⁻³"} == thousandths


def test_windows_in_which_a_metric_is_undefined_do_not_count() -> None:
    """Of one window all is told, of another with the same grids neither label nor kinds of cells nor mass."""
    generator = torch.Generator().manual_seed(0)
    forecast, target, mass, last = torch.rand(4, 1, 2, 8, 8, generator=generator)
    kinds = dict(zip(KINDS, torch.rand(len(KINDS), 1, 2, 8, 8, generator=generator) < 0.5, strict=True))
    alone, both = forecast_metrics(2), forecast_metrics(2)
    for metrics in (alone, both):
        metrics.update(forecast, target, last[:, 0], label=labelled(target), mass=mass, **kinds)
    both.update(forecast, target, last[:, 0], label=torch.zeros_like(target, dtype=torch.uint8))
    expected = {name: value for name, value in alone.compute().items() if isinstance(value, PerHorizon)}
    assert len(expected) > 30
    result = both.compute()
    for name, value in expected.items():
        assert value.mean.isfinite().all(), name
        torch.testing.assert_close(result[name].mean, value.mean, msg=name)


class Bias(HorizonMetric):
    """Mean of forecast - target: a metric of a user's own."""

    title, unit, digits, factor, direction, higher_is_better = "Bias", "%", 1, 100.0, 0.0, None

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return (forecast - target).mean((-2, -1))


def test_metrics_beside_the_standard_ones() -> None:
    metrics = forecast_metrics(2, extra=[Bias])
    target = torch.zeros(1, 2, 3, 3)
    metrics.update(target + torch.tensor([0.1, 0.2])[:, None, None], target, target[:, 0], label=labelled(target))
    result = metrics.compute()
    assert set(result) == NAMES | {"bias"}
    assert result["bias"].mean.tolist() == pytest.approx([0.1, 0.2])
    assert (result["bias"].as_json()["direction"], result["bias"].as_json()["rewards"]) == (0.0, "")


def test_a_name_is_given_once() -> None:
    for taken, by in (("mse", "HorizonMSE"), ("static_mse", "the static baseline's MSE"), ("ece", "Calibration")):
        named = type("Mine", (Bias,), {"name": taken})
        with pytest.raises(UserError, match=f"Mine: its name '{taken}' is that of {by}; give"):
            forecast_metrics(2, extra=[named])
    with pytest.raises(UserError, match="RocAuc: its name 'roc_auc' is that of RocAuc"):
        forecast_metrics(2, extra=[partial(RocAuc, bins=10)])


class Plain(HorizonMSE):
    """A metric of a user's own that is told what metrics were told before there were samples."""

    name, title = "plain", "Plain"

    def update(self, forecast: Tensor, target: Tensor, last: Tensor | None = None, index: Tensor | None = None) -> None:  # type: ignore[override]
        super().update(forecast, target, last, index)


def test_samples_and_kinds_of_cells_reach_whom_they_concern() -> None:
    generator = torch.Generator().manual_seed(0)
    metrics = forecast_metrics(2, extra=[Bias, Plain])
    samples = torch.rand(1, 16, 2, 6, 6, generator=generator)
    target, last = torch.rand(1, 2, 6, 6, generator=generator), torch.rand(1, 6, 6, generator=generator)
    moving = torch.zeros(1, 2, 6, 6, dtype=torch.bool)
    moving[..., 0, 0] = True
    kinds = {"moving": moving, "entering": ~moving, "label": labelled(target)}
    metrics.update(samples.mean(1), target, last, torch.arange(1), samples=samples, **kinds)
    result = metrics.compute()
    assert set(result) == NAMES | {"bias", "plain"}
    torch.testing.assert_close(result["plain"].mean, result["mse"].mean)
    error = (samples.mean(1) - target).square()
    torch.testing.assert_close(result["mse_moving_cells"].mean.float(), error[0, :, 0, 0])
    share = (35 * result["mse_entering_cells"].mean + result["mse_moving_cells"].mean) / 36
    torch.testing.assert_close(share, result["mse"].mean)
    assert result["spread_skill_moving_cells"].value.isfinite().all()


def test_metrics_that_agree_on_the_first_window_stay_apart() -> None:
    target = torch.tensor([[[[0.9, 0.1, 0.9]]]])
    metrics = forecast_metrics(1)
    metrics.update(target, target, target[:, 0], label=labelled(target))
    metrics.update(torch.tensor([[[[0.9, 0.9, 0.1]]]]), target, target[:, 0], label=labelled(target))
    result = metrics.compute()
    assert result["iou"].mean.item() == pytest.approx((1 + 1 / 3) / 2)
    assert result["precision"].mean.item() == pytest.approx((1 + 1 / 2) / 2)


def test_the_static_forecast_of_a_real_drive(shared: Path) -> None:
    held = np.load(shared / "reference/evidence_0005.npz")
    probability, label = torch.from_numpy(held["probability"]), torch.from_numpy(held["labels"])
    target, last = probability[5:20][None], probability[4][None]
    metrics = forecast_metrics()
    metrics.update(last[:, None].expand_as(target), target, last, label=label[5:20][None])
    result = metrics.compute()
    expected = ((probability[5:20] - probability[4]) ** 2).double().mean((1, 2))
    torch.testing.assert_close(result["mse"].mean, expected, rtol=1e-5, atol=0)
    assert (result["motion_ratio"].mean == 0).all()
    assert (result["skill"].value == 0).all()
    similarity = result["image_similarity"].mean
    assert similarity[0] < similarity[4] < similarity[14]
    parts = [result[f"image_similarity_{name}"].mean for name in ("occupied", "free", "unknown")]
    torch.testing.assert_close(sum(parts), similarity)
    assert result["iou"].mean[0] > result["iou"].mean[14]


@pytest.mark.parametrize("name", [module.name for module in pkgutil.iter_modules(envpred.metrics.__path__)])
def test_examples_in_docstrings(name: str) -> None:
    assert doctest.testmod(importlib.import_module(f"envpred.metrics.{name}")).failed == 0
