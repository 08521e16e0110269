"""What happens beside a run of Lightning's: pictures, charts, results, forecasts, validations."""

from envpred.callbacks.baselines import Baselines
from envpred.callbacks.hyperparameters import Hyperparameters
from envpred.callbacks.pictures import Pictures
from envpred.callbacks.predictions import PredictionWriter
from envpred.callbacks.results import ResultWriter
from envpred.callbacks.validations import Validations

__all__ = ["Baselines", "Hyperparameters", "Pictures", "PredictionWriter", "ResultWriter", "Validations"]
