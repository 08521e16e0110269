"""What happens beside a run of Lightning's: pictures, and what is written of forecasts."""

from envpred.callbacks.pictures import Pictures
from envpred.callbacks.predictions import PredictionWriter

__all__ = ["Pictures", "PredictionWriter"]
