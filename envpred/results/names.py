"""Names of methods as people read them, made of what a result, or a manifest of predictions, records of its model."""

from collections.abc import Mapping
from typing import Any

INPUTS = {
    **{"dst_static": "DST static", "prob_static": "probability static"},
    **{"dst_dogma": "DST DOGMa", "prob_dogma": "probability DOGMa"},
}
MODELS = {
    **{"prednet": "PredNet", "fcn": "FCN", "corrected_rollout": "Corrected rollout", "rollout": "Rollout"},
    **{"last_frame": "Static", "moved_last_frame": "Moved last frame", "particle_forecast": "Particle filter"},
    "moved_particles": "Moved last frame and particles",
    "moved_last_frame_oracle": "Last frame, true motion",
    "rollout_oracle": "Rollout, true motion",
}
STATIC = MODELS["last_frame"]
PARTICLES_AS_MASS = f"{MODELS['particle_forecast']}, occupied mass"  # scored against the mass that it forecasts
ONE_INPUT = {"corrected_rollout"}  # learned, and read the same whatever the variant
LEARNED = "learned"


def method_name(model: Mapping[str, Any], role: str, variant: str) -> str:
    """What a method is called: its class, what tells it from others of that class, and what it reads if it learned.

    >>> method_name({"name": "prednet", "hyperparameters": {"t1_epochs": 0, "t5_epochs": 9}}, "learned", "dst_static")
    'PredNet, DST static, stage t+5 alone'
    >>> method_name({"name": "last_frame"}, "static", "dst_static"), method_name({"name": "my_own"}, "learned", "pairs")
    ('Static', 'My own, pairs')

    Args:
        model: its `name` and, where they are told, `hyperparameters` and whether it is `untrained`.
        role: of the forecaster.
        variant: of its input.
    """
    name, told = str(model["name"]), model.get("hyperparameters", {})
    parts = [MODELS.get(name, _words(name).capitalize())]
    if told.get("fixed_frame"):
        parts.append("fixed frame and context" if told.get("context") else "fixed frame")
    if name == "rollout" and not told.get("movers", True):
        parts.append("standing world")
    if role == LEARNED and name not in ONE_INPUT:
        parts.append(input_name(variant))
    epochs = {stage: told.get(f"{stage}_epochs") for stage in ("t1", "t5")}
    if 0 in epochs.values() and any(epochs.values()):
        (alone,) = (stage for stage, number in epochs.items() if number)
        parts.append(f"stage t+{alone[1:]} alone")
    if model.get("untrained"):
        parts.append("untrained")
    return ", ".join(parts)


def input_name(variant: str) -> str:
    """What an input variant is called: `DST DOGMa`."""
    return INPUTS.get(variant, _words(variant))


def _words(name: str) -> str:
    return name.replace("_", " ")
