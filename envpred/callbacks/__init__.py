"""What happens beside a run of Lightning's: pictures, results, and what is written of predictions and validations."""

from envpred.callbacks.pictures import Pictures
from envpred.callbacks.predictions import PredictionWriter
from envpred.callbacks.results import ResultWriter
from envpred.callbacks.validations import Validations

__all__ = ["Pictures", "PredictionWriter", "ResultWriter", "Validations"]
