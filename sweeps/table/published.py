"""The plan of the paper's results: what it trains and compares, at three sizes."""

from collections.abc import Sequence
from dataclasses import dataclass

from envpred.cli.arguments import FitArguments, as_options
from envpred.datamodules.variants import VARIANTS

from ..runs.command import FIXED
from .plan import MAIN, STATIC, Run, seeded

GROUP = "paper"
FCN_VARIANT = "prob_dogma"  # the paper's FCN reads it
BASELINES = {
    "last_frame": "last_frame",
    "particle_forecast": "particle_forecast",
    "moved_last_frame": "moved_last_frame",
    "moved_particles": "moved_particles",
    "rollout": "rollout_static",
}


@dataclass(frozen=True)
class Preset:
    """A size of the paper's results.

    Args:
        prednet: configuration of the four PredNets.
        fcn: and of the FCN.
        drives: simulated if no others are given; 0 if there must be some.
        frames: of each of them.
    """

    prednet: str
    fcn: str
    drives: int = 0
    frames: int = 0


PRESETS = {
    "demo": Preset("demo", "demo_fcn", drives=40, frames=45),
    "small": Preset("prednet_small", "fcn_small"),
    "full": Preset("prednet", "fcn"),
}


def published_plan(preset: Preset, fit: Sequence[str], tuned: dict[str, str], seeds: Sequence[int]) -> list[Run]:
    """PredNet with every input variant in two stages, the FCN, and the baselines, on the same windows.

    Args:
        preset: their size.
        fit: options of `envpred fit` that go to all that is trained.
        tuned: a best configuration by the name of a study, `prednet_dst_static` say, which replaces the preset's.
        seeds: of initial weights and training windows.
    """
    runs = []
    trained = [("prednet", "PredNetForecaster", v, preset.prednet) for v in VARIANTS]
    for name, kind, variant, config in [*trained, ("fcn", "FCNForecaster", FCN_VARIANT, preset.fcn)]:
        best = tuned.get(f"{name}_{variant}")
        base = (f"--model=envpred.models.{kind}", f"--config={best or config}", *fit)
        runs += [Run(f"{name}_{variant}_seed{s}", (GROUP,), MAIN, (*base, *seeded(variant, s))) for s in seeds]
    data = FitArguments([*runs[0].options, "--data.store=."]).base["data"]
    windows = as_options({f"data.{name}": data[name] for name in FIXED if name not in ("store", "variant")})
    runs += [
        Run(name, (GROUP,), MAIN, (f"--config={config}", *windows, *seeded(STATIC, seeds[0])), False)
        for name, config in BASELINES.items()
    ]
    return runs
