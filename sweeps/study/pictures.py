"""Pictures of a study: optimisation history, importances, parallel coordinates, intermediate values."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import optuna
from optuna.trial import TrialState

from envpred.store.files import replaced


def _importances(study: optuna.Study) -> Any:
    """By Optuna's default from 5.0 on; the one before that needs scikit-learn."""
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    return optuna.visualization.matplotlib.plot_param_importances(study, evaluator)


PICTURES: dict[str, Callable[[optuna.Study], Any]] = {
    "history": optuna.visualization.matplotlib.plot_optimization_history,
    "importances": _importances,
    "parallel_coordinates": optuna.visualization.matplotlib.plot_parallel_coordinate,
    "intermediate_values": optuna.visualization.matplotlib.plot_intermediate_values,
}


def draw(study: optuna.Study, folder: Path) -> list[Path]:
    """Draw a study into PNG files of `folder`; returns them.

    Importances need two complete trials that differ; what cannot be drawn yet is left out.
    """
    if len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))) < 2:
        return []
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    mpl.use("Agg")
    files = []
    for name, plot in PICTURES.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that matplotlib's side of Optuna, and importances of 4, are experimental
            drawn = plot(study)
        figure: Figure = (drawn.flat[0] if hasattr(drawn, "flat") else drawn).figure
        figure.set_size_inches(9, 5)
        with replaced(folder / f"{name}.png") as part:  # other workers may draw the same at this moment
            figure.savefig(part, dpi=120, bbox_inches="tight")
        pyplot.close(figure)
        files.append(folder / f"{name}.png")
    return files
