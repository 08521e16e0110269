"""Forecasters: LightningModules that share one `validate` and one `test`, and differ in how they train."""

from envpred.models.baselines import LastFrame, MovedLastFrame, MovedLastFrameOracle, MovedParticles, ParticleForecast
from envpred.models.corrected_rollout import CorrectedRolloutForecaster
from envpred.models.fcn import FCNForecaster
from envpred.models.forecaster import Forecaster
from envpred.models.prednet import PredNetForecaster
from envpred.models.rollout import RolloutForecaster, RolloutOracle

__all__ = [
    "CorrectedRolloutForecaster",
    "FCNForecaster",
    "Forecaster",
    "LastFrame",
    "MovedLastFrame",
    "MovedLastFrameOracle",
    "MovedParticles",
    "ParticleForecast",
    "PredNetForecaster",
    "RolloutForecaster",
    "RolloutOracle",
]
