"""How forecasts were made: what a result and a manifest of predictions say of model, data, command and revision."""

import sys
from typing import Any

from envpred.models import Forecaster
from envpred.models.origins import seed
from envpred.results.result import revision, short_name


def provenance(forecaster: Forecaster, part: str) -> dict[str, Any]:
    """How the forecasts of the windows of `part` were made, as plain data."""
    trainer, data = forecaster.trainer, forecaster.dataset
    return {
        "model": {
            "name": short_name(type(forecaster).__name__),
            "class_path": f"{type(forecaster).__module__}.{type(forecaster).__qualname__}",
            "parameters": sum(p.numel() for p in forecaster.parameters()),
            "flops": forecaster.work(forecaster.batch_of(part, 0)),
            # What weights were trained with is what their checkpoint says, whatever this command did.
            "hyperparameters": (forecaster.trained or {}).get("hyperparameters", dict(forecaster.hparams)),
            "untrained": not (forecaster.is_fixed or trainer.ckpt_path or forecaster.trained),
            "trained": forecaster.trained,
        },
        "role": forecaster.role,
        "variant": data.variant,
        "data": data.describe(part),
        "seed": (forecaster.trained or {}).get("seed", seed()),
        "revision": revision(),
        "command": " ".join(["envpred", *sys.argv[1:]]),
        "checkpoint": str(trainer.ckpt_path) if trainer.ckpt_path else None,
        "horizon_s": [round(data.period * (h + 1), 6) for h in range(data.horizons)],
    }
