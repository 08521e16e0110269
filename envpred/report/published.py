"""The paper's published numbers: shown beside ours, never mixed with them."""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.results import names
from envpred.results.names import LEARNED, method_name

FloatArray = NDArray[np.float64]

SOURCE = "published: Itkina et al. 2019, seven other drives of KITTI"
STATIC = "static"
PARTICLES = "particle_forecast"
# What the curves of the paper's error figure are called: as a result of the same method is.
CURVE_NAMES = {
    "prednet_dst_dogma": method_name({"name": "prednet"}, LEARNED, "dst_dogma"),
    "fcn_prob_dogma": method_name({"name": "fcn"}, LEARNED, "prob_dogma"),
    "particle_filter": method_name({"name": PARTICLES}, "particle", ""),
    STATIC: names.STATIC,
}


@dataclass(frozen=True)
class Curve:
    """Published mean squared error: at `horizon_s`, its `mean` and `standard_error`, all (N,)."""

    horizon_s: FloatArray
    mean: FloatArray
    standard_error: FloatArray

    def at(self, seconds: float) -> tuple[float, float] | None:
        """Mean and standard error at a horizon, None where nothing was published."""
        place = np.flatnonzero(np.isclose(self.horizon_s, seconds))
        return (float(self.mean[place[0]]), float(self.standard_error[place[0]])) if len(place) else None


@cache
def _data() -> dict[str, Any]:
    data: dict[str, Any] = json.loads((resources.files("envpred.report") / "published.json").read_text("utf-8"))
    return data


def curves() -> dict[str, Curve]:
    """The curves of the paper's error figure."""
    found = {}
    for name, curve in _data()["curves"].items():
        steps = sorted(curve["mse"], key=int)
        mean, error = ([curve[key][step] for step in steps] for key in ("mse", "standard_error"))
        found[name] = Curve(np.array([int(step) / 10 for step in steps]), np.array(mean), np.array(error))
    return found


def table_1() -> dict[str, Curve]:
    """The rows of the paper's Table I: PredNet with each input variant."""
    table = _data()["table_1"]
    horizon_s = np.array(table["horizons_s"])
    rows = {name: np.array(row) / 1e3 for name, row in table["mse_x1e3_and_standard_error_x1e3"].items()}
    return {name: Curve(horizon_s, row[:, 0], row[:, 1]) for name, row in rows.items()}


def counterpart(name: str, role: str, variant: str) -> Curve | None:
    """What the paper published for the method `name`, as results name it, of that role and input; None if nothing."""
    if name == "prednet":
        return table_1().get(variant)
    key = curve_of(name, role, variant)
    return curves()[key] if key else None


def curve_of(name: str, role: str, variant: str) -> str | None:
    """Which of the paper's `curves` is of the method `name`, as results name it; None if none is."""
    if role == "static":
        return STATIC
    if name == PARTICLES:  # reads the filter's particles, whatever the variant
        return "particle_filter"
    key = f"{name}_{variant}"
    return key if key in curves() else None
