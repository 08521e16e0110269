"""Every command, and where it is written: read by whoever lists commands, so that nothing of them is loaded."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One command of ours.

    Args:
        function: where it is written; its arguments are the command line's.
        positional: the argument that is given without a name, if there is one, and how many it takes.
        configs: kinds of configurations that its --config knows by name.
        takes_fit: whether options of `envpred fit` go along with its own, to every run.
        repeated: options that may be given several times, one value each, commas and all.
    """

    function: str
    positional: tuple[str, str | None] | None = None
    configs: tuple[str, ...] = ()
    takes_fit: bool = False
    repeated: tuple[str, ...] = ()


COMMANDS = {
    "grids": Command("envpred.cli.commands.grids", configs=("grids",)),
    "check": Command("envpred.cli.check.check", ("source", None)),
    "verify": Command("envpred.cli.commands.verify"),
    "ground": Command("envpred.cli.commands.ground"),
    "show": Command("envpred.cli.commands.show"),
    "velocity": Command("envpred.cli.commands.velocity"),
    "report": Command("envpred.cli.commands.report", ("runs", "+"), repeated=("label",)),
    "draw": Command("envpred.cli.commands.draw", ("predictions", "+")),
    "bag": Command("envpred.live.bag.bag"),
    "live": Command("envpred.cli.live.live", ("source", None), ("model", "data", "preset"), takes_fit=True),
    "export_weights": Command("envpred.cli.commands.export_weights", ("run", None)),
    "tune": Command("sweeps.tune.tune", configs=("model", "data", "preset"), takes_fit=True),
    "ablate": Command("sweeps.ablation.ablation", configs=("model", "data", "preset"), takes_fit=True),
    "paper": Command("sweeps.paper.paper", configs=("model", "data", "preset"), takes_fit=True),
    "simulate": Command("envpred.simulate.commands.simulate", ("out", None)),
    "realism": Command("envpred.simulate.commands.realism"),
    "record": Command("envpred.simulate.commands.record", ("out", None)),
    "scan": Command("envpred.simulate.commands.scan"),
    "traffic": Command("envpred.simulate.commands.traffic"),
    "configs": Command("envpred.cli.shipped.configs"),
    "completion": Command("envpred.cli.completion.completion", ("shell", None)),
}

# Lightning's own, and what we say of them.
LIGHTNING = {
    "fit": "Train a forecaster on the training drives of a store of grids.",
    "validate": "Measure a forecaster on the validation drives.",
    "test": "Measure a forecaster on the test drives, beside the static baseline.",
    "predict": "Write a forecaster's forecasts as arrays.",
}
