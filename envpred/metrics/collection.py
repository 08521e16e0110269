"""The set of metrics that a test run reports."""

from collections.abc import Callable, Sequence

from torchmetrics import MetricCollection

from envpred.errors import UserError
from envpred.metrics.best_of_k import BestOfK
from envpred.metrics.brier import Brier
from envpred.metrics.calibration import Calibration
from envpred.metrics.changed_cells import ChangedMSE, EnteringMSE, MovingMSE, StaticMSE
from envpred.metrics.crps import CRPS
from envpred.metrics.fractions_skill import FractionsSkill
from envpred.metrics.horizon_mse import HorizonMSE, MassMSE
from envpred.metrics.image_similarity import Empty, ImageSimilarity
from envpred.metrics.log_score import LogScore
from envpred.metrics.motion_ratio import MotionRatio
from envpred.metrics.overlap import IoU, Precision, Recall
from envpred.metrics.pr_auc import PrAuc
from envpred.metrics.roc_auc import RocAuc
from envpred.metrics.skill import StaticSkill
from envpred.metrics.soft_iou import SoftIoU
from envpred.metrics.spread_skill import SpreadSkill
from envpred.metrics.windows import WindowMetric

STATIC_MSE = "static_mse"  # beside them in a result: the static baseline's `mse` on the same windows


def forecast_metrics(
    horizons: int = 15, empty: Empty = "penalty", extra: Sequence[Callable[[int], WindowMetric]] = ()
) -> MetricCollection:
    """All metrics of forecasts at `horizons` steps, to be updated with (forecast, target, last, index).

    By keyword also with `label`, which many need, `samples` and the kinds of cells, see `Judged`.

    `compute()` gives a dict: `mse`, `mse_occupied_mass`, `mse_changed_cells`, `mse_static_cells`, `mse_moving_cells`,
    `mse_entering_cells`, `iou`, `precision`, `recall`, `soft_iou`, `fractions_skill`, `roc_auc`, `pr_auc`,
    `motion_ratio`, `image_similarity` and its three classes are `PerHorizon`, as are `brier`, `log_score`, `ece`,
    `crps`, `mse_best_of_k` and these over each kind of cells (`brier_moving_cells`); `skill` (against the static
    baseline), `spread_skill` and its kinds are a `Ratio`, `reliability` has a type of its own; all have `as_json()`.

    Squared error, CRPS, spread and skill, motion ratio and image similarity compare with the `target`, the evidence
    remembered in the map, as the paper does; the others judge by what was measured in the target's frame alone.

    Args:
        horizons: steps that are forecast.
        empty: policy of the image similarity for a class that both maps lack.
        extra: further metrics, each a class (or what makes one) of a number of horizons; they go by their `name`.

    Raises:
        UserError: if two metrics have one name.
    """
    standard: list[WindowMetric] = [
        HorizonMSE(horizons),
        MassMSE(horizons),
        ChangedMSE(horizons),
        StaticMSE(horizons),
        MovingMSE(horizons),
        EnteringMSE(horizons),
        StaticSkill(horizons),
        ImageSimilarity(horizons, empty),
        IoU(horizons),
        Precision(horizons),
        Recall(horizons),
        SoftIoU(horizons),
        FractionsSkill(horizons),
        RocAuc(horizons),
        PrAuc(horizons),
        Brier(horizons),
        LogScore(horizons),
        Calibration(horizons),
        MotionRatio(horizons),
        CRPS(horizons),
        SpreadSkill(horizons),
        BestOfK(horizons),
    ]
    chosen: dict[str, WindowMetric] = {}
    owner = {STATIC_MSE: "the static baseline's MSE"}
    for metric in (*standard, *(make(horizons) for make in extra)):
        kind = type(metric).__name__
        for taken in {metric.name, *metric.outputs} & owner.keys():
            raise UserError(f"{kind}: its name {taken!r} is that of {owner[taken]}; give the class another `name`")
        owner |= dict.fromkeys((metric.name, *metric.outputs), kind)
        chosen[metric.name] = metric
    # Groups are found by comparing states after the first window: a perfect first forecast would merge IoU,
    # precision and recall for good.
    return MetricCollection(dict(chosen), compute_groups=False)
