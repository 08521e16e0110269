"""The command line: Lightning's fit, validate, test and predict, and our own commands in the same style.

envpred grids --source KITTI --store grids/
envpred fit --config configs/model/prednet.yaml --config configs/data/dst_static.yaml --data.store grids/
"""

import logging
import sys
import warnings
from argparse import RawDescriptionHelpFormatter
from pathlib import Path
from typing import TypeVar

import torch
from jsonargparse import DefaultHelpFormatter, Namespace
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI

from envpred import __version__
from envpred.callbacks import Pictures, PredictionWriter, ResultWriter, Validations
from envpred.cli.commands import COMMANDS
from envpred.cli.configs import portable
from envpred.datamodules import GridDataModule
from envpred.errors import UserError
from envpred.models import Forecaster
from envpred.models.checkpoints import read_checkpoint
from envpred.results.result import short_name

RUNS = Path("runs")


class HelpFormatter(DefaultHelpFormatter, RawDescriptionHelpFormatter):
    """Help whose list of commands keeps its lines."""


class EnvpredCLI(LightningCLI):
    """LightningCLI whose checkpoints never replace what the user says, and whose runs lie in runs/<model>/<variant>."""

    untrained = False  # whether --ckpt_path none was given

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.link_arguments("data.variant", "model.init_args.variant")
        parser.link_arguments("data.given", "model.init_args.given")
        parser.add_lightning_class_args(PredictionWriter, "predictions")
        parser.add_lightning_class_args(ResultWriter, "results")

    def _parse_ckpt_path(self) -> None:
        """Find the checkpoint that `best` and `last` stand for, and refuse what is none.

        Lightning would merge the checkpoint's hyperparameters over the command line here.  Ours are compared when the
        weights are loaded, and refused if they do not fit (`Forecaster.on_load_checkpoint`).
        """
        options = self.config.get(self.config.subcommand or "") or {}
        asked = options.get("ckpt_path")
        if asked is None:
            return
        if asked == "none":  # weights as they are initialised, on purpose
            options["ckpt_path"], self.untrained = None, True
            return
        file = Path(asked)
        if asked in ("best", "last"):
            file = self._newest(asked)
            print(f"checkpoint: {file}", file=sys.stderr)
        read_checkpoint(file)
        options["ckpt_path"] = str(file)
        options["weights_only"] = True

    def before_instantiate_classes(self) -> None:
        """Log to runs/<model>/<variant>, a resumed run into its own folder; keep no prediction in memory."""
        options = self.config[self.subcommand] if self.subcommand else self.config
        if self.subcommand == "predict":
            options.return_predictions = False  # they are on the disk
        if options.trainer.logger in (None, True):
            name, version = f"{self._model_name()}/{options.data.variant}", None
            checkpoint = options.get("ckpt_path")
            if self.subcommand == "fit" and checkpoint and Path(checkpoint).parent.name == "checkpoints":
                run = Path(checkpoint).resolve().parents[1]
                if run.parent == (RUNS / name).resolve():
                    version = run.name
            options.trainer.logger = Namespace(
                class_path="lightning.pytorch.loggers.TensorBoardLogger",
                init_args=Namespace(save_dir=str(RUNS), name=name, version=version, default_hp_metric=False),
            )

    def after_instantiate_classes(self) -> None:
        """Refuse random weights, and leave the schedule to the model: Lightning would warn of 1000 epochs."""
        self._check_weights()
        if self.subcommand == "fit" and self.config.fit.trainer.max_epochs is None and self.model.epochs is not None:
            self.trainer.fit_loop.max_epochs = self.model.epochs

    def _check_weights(self) -> None:
        """Refuse to judge weights that nobody has trained, unless that is asked for."""
        options = self.config[self.subcommand] if self.subcommand else self.config
        if self.subcommand in (None, "fit") or options.get("ckpt_path") or self.untrained or self.model.is_fixed:
            return
        try:
            hint = f"give --ckpt_path {self._newest('best')}"
        except UserError:
            hint = "train it by `envpred fit`, then give --ckpt_path best"
        raise UserError(
            f"the weights of {type(self.model).__name__} must come from a checkpoint, or random ones would be judged; "
            f"{hint} (or --ckpt_path none, for random weights on purpose)"
        )

    def _model_name(self) -> str:
        options = self.config[self.config.subcommand] if self.config.subcommand else self.config
        return _short(options.model.class_path)

    def _newest(self, which: str) -> Path:
        """The newest `best` or `last` checkpoint among the runs of this model and variant."""
        variant: str = self.config[self.config.subcommand].data.variant
        folder = RUNS / self._model_name() / variant
        wanted = ("best.ckpt", "best_t1.ckpt") if which == "best" else ("last.ckpt",)
        for run in sorted(folder.glob("version_*"), key=lambda f: int(f.name.split("_")[1]), reverse=True):
            for name in wanted:
                if (run / "checkpoints" / name).is_file():
                    return run / "checkpoints" / name
        raise UserError(f"{folder}: no run with a checkpoint {wanted[0]}; run `envpred fit` first, or give its path")


def _short(class_path: str) -> str:
    return short_name(class_path.rsplit(".", 1)[1])


C = TypeVar("C", bound=EnvpredCLI)


def lightning(args: list[str] | None = None, kind: type[C] = EnvpredCLI, run: bool = True) -> C:  # type: ignore[assignment]
    """Run fit, validate, test or predict with `args`; who only reads them gives a `kind` of its own and no `run`."""
    torch.set_float32_matmul_precision("high")  # TF32 where a GPU has it; nothing changes on a CPU
    warnings.filterwarnings("ignore", "LightningCLI's args parameter is intended")  # `main` takes them from sys.argv
    warnings.filterwarnings("ignore", ".*treespec, LeafSpec.*")  # Lightning's own affair
    warnings.filterwarnings("ignore", ".*does not have many workers.*")  # reading a window takes a millisecond
    logging.getLogger("lightning.pytorch.utilities.rank_zero").addFilter(_no_advertisement)
    return kind(
        Forecaster,
        GridDataModule,
        subclass_mode_model=True,
        seed_everything_default=0,
        auto_configure_optimizers=False,
        load_from_checkpoint_support=False,
        save_config_kwargs={"overwrite": True},
        trainer_defaults={"callbacks": [Pictures(), Validations()], "log_every_n_steps": 10},
        parser_kwargs={
            "prog": "envpred",
            "version": __version__,
            "epilog": _epilog(),
            "formatter_class": HelpFormatter,
        },
        args=portable(sys.argv[1:] if args is None else args),
        run=run,
    )


def _no_advertisement(record: logging.LogRecord) -> bool:
    """Whether a line of Lightning's says something about the run, rather than about its makers' other products."""
    return "Tip: For seamless" not in record.getMessage()


def _epilog() -> str:
    lines = [f"  {name:10} {(function.__doc__ or '').splitlines()[0]}" for name, function in COMMANDS.items()]
    return "more commands (each with its own --help):\n" + "\n".join(lines)
