"""The set of metrics that a test run reports."""

from torchmetrics import MetricCollection

from envpred.metrics.brier import Brier
from envpred.metrics.calibration import Calibration
from envpred.metrics.changed_cells import DynamicMSE, StaticMSE
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.image_similarity import Empty, ImageSimilarity
from envpred.metrics.motion_ratio import MotionRatio
from envpred.metrics.overlap import IoU, Precision, Recall
from envpred.metrics.roc_auc import RocAuc
from envpred.metrics.skill import StaticSkill


def forecast_metrics(horizons: int = 15, empty: Empty = "penalty") -> MetricCollection:
    """All metrics of forecasts at `horizons` steps, to be updated with (forecast, target, last, index).

    `compute()` gives a dict: `mse`, `mse_dynamic_cells`, `mse_static_cells`, `iou`, `precision`, `recall`, `roc_auc`,
    `brier`, `motion_ratio`, `image_similarity` and its three classes, `ece` are `PerHorizon`; `skill` (against the
    static baseline) and `reliability` have types of their own; all have `as_json()`.  `empty` is the policy of the
    image similarity for a class that both maps lack.
    """
    return MetricCollection(
        {
            "mse": HorizonMSE(horizons),
            "mse_dynamic_cells": DynamicMSE(horizons),
            "mse_static_cells": StaticMSE(horizons),
            "skill": StaticSkill(horizons),
            "image_similarity": ImageSimilarity(horizons, empty),
            "iou": IoU(horizons),
            "precision": Precision(horizons),
            "recall": Recall(horizons),
            "roc_auc": RocAuc(horizons),
            "brier": Brier(horizons),
            "calibration": Calibration(horizons),
            "motion_ratio": MotionRatio(horizons),
        },
        # Groups are found by comparing states after the first window: a perfect first forecast would merge IoU,
        # precision and recall for good.
        compute_groups=False,
    )
