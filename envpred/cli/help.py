"""Help that is there at once: ours first, of Lightning's options those that are used most."""

from argparse import SUPPRESS, ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from typing import Any

from envpred.cli.registry import COMMANDS, LIGHTNING
from envpred.cli.signatures import Option, exported, options, summary

DATA, WRITER, RESULTS, PICTURES = (
    "envpred.datamodules.GridDataModule",
    "envpred.callbacks.PredictionWriter",
    "envpred.callbacks.ResultWriter",
    "envpred.callbacks.Pictures",
)
MODELS = "envpred.models"
# Of the options of Lightning's trainer those that most runs need, if any.
TRAINER = {
    "max_epochs": "epochs at most; the schedule itself is the model's",
    "accelerator": "auto, cpu, gpu, ...; by default what is there",
    "devices": "how many, or which",
    "precision": "32-true, bf16-mixed, ...",
    "limit_train_batches": "number, or share, of an epoch's batches; also limit_val_batches, limit_test_batches",
    "enable_progress_bar": "true or false",
    "logger": "class of a logger; by default TensorBoard's",
    "fast_dev_run": "one batch of everything, and nothing is written",
}
# Options that Lightning's commands have beside those of models, data and trainer.
RUN = {
    "name": Option("name", "str | None", "None", "of the run's folder; by default version_N"),
    "out": Option("out", "Path", "'runs'", "folder of all runs; this one lies in OUT/COMMAND/<model>/<variant>/NAME."),
    "ckpt_path": Option(
        "ckpt_path",
        "str | None",
        "None",
        "checkpoint to take weights from, or to resume; best or last: those of the newest fit of this model and "
        "variant; none: random weights on purpose.",
    ),
    "weights": Option(
        "weights",
        "str | None",
        "None",
        "weights that ship (`envpred configs` lists them), or a folder alike, with their model's configuration.",
    ),
    "seed_everything": Option("seed_everything", "int", "0", "seed of everything random."),
}


METAVARS = {"int": "N", "float": "X", "Path": "PATH"}  # of options of these types; others have their own name


class _Formatter(RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=110)


def top() -> ArgumentParser:
    """All commands, a line each."""
    width = max(map(len, COMMANDS)) + 2
    groups = [("train and judge (PyTorch Lightning)", LIGHTNING)]
    told = {name: summary(command.function) for name, command in COMMANDS.items()}
    groups.append(("everything else", told))
    lines = [
        line
        for title, commands in groups
        for line in (f"\n{title}:", *(f"  {name:{width}}{text}" for name, text in commands.items()))
    ]
    return ArgumentParser(
        prog="envpred",
        usage="envpred COMMAND [options]; `envpred COMMAND --help` lists them",
        description="\n".join(lines).lstrip(),
        formatter_class=_Formatter,
        epilog="-h, --help     this list\n--version      version of envpred",
        add_help=False,
    )


def of_command(name: str) -> ArgumentParser:
    """A parser with the options of one of our own commands, to be shown or completed."""
    command = COMMANDS[name]
    positional, count = command.positional or (None, None)
    found = options(command.function, skip=("fit",))
    needed = [
        f"--{option.name} {_metavar(option)}"
        for option in found
        if option.default is None and option.name != positional
    ]
    first = [f"{positional.upper()}{' ...' if count else ''}"] if positional else []
    parser = ArgumentParser(
        prog=f"envpred {name}",
        usage=" ".join([f"envpred {name}", *first, *needed, "[options]"]),
        description=summary(command.function),
        formatter_class=_Formatter,
        add_help=False,
    )
    for option in found:
        if option.name == positional:
            parser.add_argument(option.name, nargs=count, help=option.text, metavar=option.name.upper())
    group = parser.add_argument_group("options")
    for option in sorted(found, key=lambda option: option.default is not None):
        if option.name != positional and "." not in option.name:
            _add(group, option)
    for part in dict.fromkeys(option.name.split(".")[0] for option in found if "." in option.name):
        inner = parser.add_argument_group(part)
        for option in found:
            if option.name.startswith(f"{part}."):
                _add(inner, option)
    group.add_argument("--config", metavar="NAME", help=_config_help(command.configs))
    if command.takes_fit:
        where = "go to every run" if command.function.startswith("sweeps.") else "say which forecaster"
        parser.epilog = f"options of `envpred fit` (--config, --model.*, --data.*, --trainer.*) {where}"
    _add_helps(group)
    return parser


def of_lightning(name: str) -> ArgumentParser:
    """A parser with the options of fit, validate, test or predict that are ours, to be shown or completed."""
    parser = ArgumentParser(
        prog=f"envpred {name}",
        usage=f"envpred {name} --config NAME [--config NAME ...] --data.store DIR [options]",
        description=f"{LIGHTNING[name]}\n\nOptions and configurations count from left to right: the later wins.",
        formatter_class=_Formatter,
        add_help=False,
    )
    run = parser.add_argument_group("run")
    run.add_argument("--config", metavar="NAME", help=_config_help(("model", "data")))
    for option in of_run(name):
        _add(run, option)
    _add_helps(run)
    model = parser.add_argument_group("model")
    model.add_argument("--model", metavar="CLASS", help="a forecaster of ours, or module.Class of your own")
    model.add_argument("--model.help", metavar="CLASS", nargs="?", help="list the forecasters, or one's options")
    model.add_argument("--model.NAME", metavar="VALUE", help="an option of the forecaster").completer = SUPPRESS  # type: ignore[attr-defined]
    data = parser.add_argument_group("data")
    for option in sorted(options(DATA, "data."), key=lambda option: option.default is not None):
        _add(data, option)
    if name == "predict":
        _add_all(parser.add_argument_group("predictions"), options(WRITER, "predictions."))
    if name == "test":
        _add_all(parser.add_argument_group("results"), options(RESULTS, "results."))
    if name != "predict":
        _add_all(parser.add_argument_group("pictures"), options(PICTURES, "pictures."))
    trainer = parser.add_argument_group("trainer (Lightning's; --help_all lists all)")
    for short, text in TRAINER.items():
        trainer.add_argument(f"--trainer.{short}", metavar=short.rsplit("_", 1)[-1].upper(), help=text)
    return parser


def of_run(command: str) -> list[Option]:
    """The options of one of Lightning's commands beside those of models, data and trainer."""
    return [option for option in RUN.values() if not (command == "fit" and option.name == "weights")]


def forecasters() -> str:
    """The forecasters that ship, a line each."""
    found = {name: summary(path) for name, path in exported(MODELS).items() if name != "Forecaster"}
    width = max(map(len, found)) + 2
    lines = [f"  {name:{width}}{text}" for name, text in found.items()]
    end = (
        "`--model.help NAME` lists the options of one; one of your own is module.Class of a file in the current folder"
    )
    return "\n".join(["forecasters (--model NAME):", *lines, "", end])


def known(command: str) -> list[str]:
    """Names of the options of a command, for whoever mistypes one."""
    if command in LIGHTNING:
        found = [option.name for option in options(DATA, "data.")] + [f"trainer.{short}" for short in TRAINER]
        return [*(option.name for option in of_run(command)), "config", "model", "model.help", "help_all", *found]
    return [*(option.name for option in options(COMMANDS[command].function, skip=("fit",))), "config"]


def _config_help(kinds: Sequence[str]) -> str:
    return (
        f"a configuration: a name that ships ({', '.join(kinds)}: `envpred configs`), or a YAML file"
        if kinds
        else ("a YAML file with options")
    )


def _add_helps(group: Any) -> None:
    group.add_argument("-h", "--help", action="store_true", help="this list")
    group.add_argument("--help_all", action="store_true", help="every option, with types; takes seconds")
    group.add_argument("--print_config", action="store_true", help="print the configuration that results, and end")


def _add_all(group: Any, found: Sequence[Option]) -> None:
    for option in found:
        _add(group, option)


def _add(group: Any, option: Option) -> None:
    """Show an option: a flag without a value, what must be given said so, a default where it says something."""
    text = option.text.replace("%", "%%").rstrip(".")
    if option.default is None:
        text += " (required)"
    elif option.default not in ("None", "False") and "(" not in option.default:
        default = option.default.strip("'")
        text += f" (default: {default})"
    if option.is_flag:
        group.add_argument(f"--{option.name}", action="store_true", help=text)
    else:
        group.add_argument(f"--{option.name}", metavar=_metavar(option), help=text)


def _metavar(option: Option) -> str:
    if option.choices:
        return "{" + ",".join(option.choices) + "}"
    return METAVARS.get(option.kind.removesuffix(" | None"), option.name.rsplit(".", 1)[-1].upper())
