"""Lightning's fit, validate, test and predict, with our folders, checkpoints and messages."""

import logging
import sys
import warnings
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

import torch
from jsonargparse import Namespace
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Trainer
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from envpred.callbacks import Baselines, Hyperparameters, Pictures, PredictionWriter, ResultWriter, Validations
from envpred.cli.begun import clear, own_folder
from envpred.cli.configs import portable
from envpred.cli.endings import end_of_fit, end_of_test, end_of_validation
from envpred.cli.help import DATA, RUN
from envpred.cli.mistakes import Strict
from envpred.cli.newest import about_checkpoint, newest_checkpoint
from envpred.cli.registry import LIGHTNING
from envpred.cli.shipped import COMPLETE
from envpred.cli.signatures import options
from envpred.cli.tokens import plain
from envpred.cli.unfinished import told_if_ended
from envpred.cli.weights import check_alone, take, with_configuration
from envpred.datamodules import GridDataModule
from envpred.errors import UserError, as_raised, check_number, one_line
from envpred.models import Forecaster
from envpred.models.checkpoints import read_checkpoint
from envpred.results.result import short_name

rank_zero_log = logging.getLogger("lightning.pytorch.utilities.rank_zero")


class _Parser(Strict, LightningArgumentParser):
    """Lightning's parser, with our messages."""


class EnvpredCLI(LightningCLI):
    """LightningCLI whose checkpoints never replace what the user says; runs lie in OUT/COMMAND/<model>/<variant>."""

    untrained = False  # whether --ckpt_path none was given
    placed = False  # whether the run's folder is ours to choose

    def __init__(self, *positional: Any, **named: Any) -> None:
        given = named["args"][:1]
        self.command = given[0] if given and given[0] in LIGHTNING else "fit"
        super().__init__(*positional, **named)

    def init_parser(self, **kwargs: Any) -> LightningArgumentParser:
        parser = _Parser(**kwargs)
        parser.command = self.command
        parser.add_argument("-c", "--config", action="config", help="path to a configuration file in YAML")
        return parser

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.link_arguments("data.variant", "model.init_args.variant")
        parser.link_arguments("data.given", "model.init_args.given")
        parser.add_lightning_class_args(PredictionWriter, "predictions")
        parser.add_lightning_class_args(ResultWriter, "results")
        parser.add_lightning_class_args(Pictures, "pictures")
        parser.add_argument("--name", type=str | None, default=None, help=RUN["name"].text)
        parser.add_argument("--out", type=Path, default=Path("runs"), help=RUN["out"].text)
        if self.command != "fit":
            parser.add_argument("--weights", type=str | None, default=None, help=RUN["weights"].text)

    def _parse_ckpt_path(self) -> None:
        """Find the checkpoint that `best` and `last` stand for, and refuse what is none.

        Lightning would merge the checkpoint's hyperparameters over the command line here.  Ours are compared when the
        weights are loaded, and refused if they do not fit (`Forecaster.on_load_checkpoint`).
        """
        options = self.config.get(self.config.subcommand or "") or {}
        asked = options.get("ckpt_path")
        check_alone(options)
        if asked is None:
            return
        if asked == "none":  # weights as they are initialised, on purpose
            options["ckpt_path"], self.untrained = None, True
            return
        file = Path(asked)
        if asked in ("best", "last"):
            file = newest_checkpoint(self._place("fit"), asked)
            print(f"checkpoint: {file} ({about_checkpoint(file)})", file=sys.stderr)
        read_checkpoint(file)
        options["ckpt_path"] = str(file)
        options["weights_only"] = True

    def before_instantiate_classes(self) -> None:
        """Log to OUT/COMMAND/<model>/<variant>, a resumed run into its own folder; keep no prediction in memory."""
        options = self._options
        if self.subcommand == "predict":
            options.return_predictions = False  # they are on the disk
        if self.subcommand != "fit":
            warnings.filterwarnings("ignore", "The dirpath has changed")  # they write into a folder of their own
        if not any("ModelCheckpoint" in callback.class_path for callback in options.trainer.callbacks or []):
            rank_zero_log.addFilter(_no_default_replaced)
        if self.subcommand in ("validate", "test"):
            options.verbose = False  # Lightning's table has 17 digits and no standard errors; ours says it
        name, options.name = options.name, None  # another run of the same configuration has another name
        if options.trainer.logger in (None, True):
            place = self._place("fit" if self.subcommand is None else self.subcommand)
            run = self._resumed()
            if self.subcommand == "fit":
                rank_zero_only(clear)(place)
            if run is not None and run.parent == place.resolve() and name in (None, run.name):
                name = run.name  # `place` stays as written: Lightning forgets the best where paths differ
                warnings.filterwarnings("ignore", "Checkpoint directory .* exists and is not empty")
            elif name is not None and (place / name).exists():
                raise UserError(f"{place / name}: is there already; give another --name, or remove it")
            self.placed = True
            options.trainer.logger = Namespace(
                class_path="lightning.pytorch.loggers.TensorBoardLogger",
                # A version that is a text would show its last letters in the progress bar.
                init_args=Namespace(
                    save_dir=str(place), name=name or "", version=None if name is None else "", default_hp_metric=False
                ),
            )

    def instantiate_classes(self) -> None:
        with as_raised():
            super().instantiate_classes()

    def _set_seed(self) -> None:
        seed = self._options.get("seed_everything")
        if isinstance(seed, int) and not isinstance(seed, bool):
            check_number("seed_everything", seed, 0, 2**32 - 1)
        super()._set_seed()

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        """The trainer; what Lightning says of its options in several ways is a user's mistake, in one line."""
        check_accelerator(self._options.trainer.accelerator)
        try:
            return super().instantiate_trainer(**kwargs)
        except (MisconfigurationException, ModuleNotFoundError, TypeError, ValueError) as error:
            reason = one_line(error).rstrip(".")
            raise UserError(f"--trainer: {reason}; `envpred fit --help_all` lists what it takes") from None

    def after_instantiate_classes(self) -> None:
        """Refuse random weights and what has none, leave the schedule to the model, and log at least once an epoch.

        Lightning would warn of 1000 epochs, and log no training loss where epochs have fewer batches than its interval.
        """
        take(self.model, self._options)
        self._check_weights()
        if self.subcommand == "fit" and self.model.is_fixed:
            name = type(self.model).__name__
            raise UserError(f"{name} has no parameters, so there is nothing to fit; `envpred test` it")
        if self.placed:  # what is saved of the configuration is for runs in other places, too
            self._options.trainer.logger = None
        batches = max(1, self.datamodule.samples // (self.datamodule.batch_size * self.trainer.world_size))
        self.trainer.log_every_n_steps = min(self.trainer.log_every_n_steps, batches)  # type: ignore[attr-defined]
        if self.subcommand == "fit" and self.config.fit.trainer.max_epochs is None and self.model.epochs is not None:
            self.trainer.fit_loop.max_epochs = self.model.epochs

    def after_fit(self) -> None:
        self._say(end_of_fit(self.trainer))

    def after_validate(self) -> None:
        self._say(end_of_validation(self.trainer, self.model))

    def after_test(self) -> None:
        self._say(end_of_test(self.trainer, self.model))

    def _say(self, lines: list[str]) -> None:
        """Say at the end of a command what came of it, in one process."""
        if self.trainer.is_global_zero:
            print("\n".join(lines), flush=True)

    def _check_weights(self) -> None:
        """Refuse to judge weights that nobody has trained, unless that is asked for."""
        given = self._options.get("ckpt_path") or self._options.get("weights") or self.untrained
        if self.subcommand in (None, "fit") or given or self.model.is_fixed:
            return
        try:
            hint = f"give --ckpt_path {newest_checkpoint(self._place('fit'), 'best')}"
        except UserError:
            hint = "train it by `envpred fit`, then give --ckpt_path best"
        raise UserError(
            f"the weights of {type(self.model).__name__} must come from a checkpoint, or random ones would be judged; "
            f"{hint} (or --ckpt_path none, for random weights on purpose)"
        )

    def _run_subcommand(self, subcommand: str) -> None:
        with self._own_folder(subcommand), told_if_ended(self.trainer):
            super()._run_subcommand(subcommand)

    def _own_folder(self, subcommand: str) -> AbstractContextManager[None]:
        """Keep other trainings out of the run's folder, if it is ours to choose and checkpoints say how far it came."""
        logger = self.trainer.logger
        kept = subcommand == "fit" and self.placed and self.trainer.checkpoint_callbacks and self.trainer.is_global_zero
        return own_folder(Path(logger.log_dir)) if kept and isinstance(logger, TensorBoardLogger) else nullcontext()

    @property
    def _options(self) -> Namespace:
        """The configuration of the subcommand."""
        subcommand = self.config.get("subcommand")
        chosen: Namespace = self.config[subcommand] if subcommand else self.config
        return chosen

    def _resumed(self) -> Path | None:
        """The run whose checkpoint a fit goes on from."""
        checkpoint = self._options.get("ckpt_path") if self.subcommand == "fit" else None
        if not checkpoint or Path(checkpoint).parent.name != "checkpoints":
            return None
        return Path(checkpoint).resolve().parents[1]

    def _place(self, subcommand: str) -> Path:
        """The folder of the runs of a subcommand with this model and variant."""
        model = short_name(self._options.model.class_path.rsplit(".", 1)[1])
        return Path(self._options.out) / subcommand / model / str(self._options.data.variant)


def check_accelerator(name: object) -> None:
    """Refuse a GPU where torch finds none, before anything is read that it would work on.

    Raises:
        UserError: naming what takes what there is.
    """
    if name in ("gpu", "cuda") and not torch.cuda.is_available():
        raise UserError(f"--trainer.accelerator {name}: torch finds no GPU here; give --trainer.accelerator auto")


C = TypeVar("C", bound=EnvpredCLI)


def lightning(args: list[str] | None = None, kind: type[C] = EnvpredCLI, run: bool = True) -> C:  # type: ignore[assignment]
    """Run fit, validate, test or predict with `args`; who only reads them gives a `kind` of its own and no `run`."""
    torch.set_float32_matmul_precision("high")  # TF32 where a GPU has it; nothing changes on a CPU
    warnings.filterwarnings("ignore", "LightningCLI's args parameter is intended")  # `main` takes them from sys.argv
    warnings.filterwarnings("ignore", ".*treespec, LeafSpec.*")  # Lightning's own affair
    warnings.filterwarnings("ignore", ".*does not have many workers.*")  # reading a window takes a millisecond
    # Metrics put the windows of all processes together themselves, each once.
    warnings.filterwarnings("ignore", "Using `DistributedSampler` with the dataloaders. During")
    warnings.filterwarnings("ignore", r"It is recommended to use `self\.log\('(val|static|moved|test)/(mse|skill)")
    rank_zero_log.removeFilter(_no_default_replaced)  # of a command before this one
    rank_zero_log.addFilter(_about_the_run)
    return kind(
        Forecaster,
        GridDataModule,
        subclass_mode_model=True,
        seed_everything_default=0,
        auto_configure_optimizers=False,
        load_from_checkpoint_support=False,
        save_config_kwargs={"overwrite": True},
        trainer_defaults={"callbacks": [Validations(), Baselines(), Hyperparameters()], "log_every_n_steps": 10},
        parser_kwargs={"prog": "envpred"},
        args=as_parsed(sys.argv[1:] if args is None else args),
        run=run,
    )


def as_parsed(args: list[str]) -> list[str]:
    """A command line as its parser takes it, see `envpred.cli.tokens` and `envpred.cli.configs`."""
    tokens = ["--help" if token == "--help_all" else token for token in args]
    return portable(with_configuration(plain(tokens, [*options(DATA, "data."), *RUN.values()], COMPLETE)))


def _about_the_run(record: logging.LogRecord) -> bool:
    """Whether a line of Lightning's says something about the run, rather than of its makers' products or its ways."""
    return not any(t in record.getMessage() for t in ("Tip: For seamless", "to estimate number of stepping batches"))


def _no_default_replaced(record: logging.LogRecord) -> bool:
    """Whether a line says more than that a model keeps its own checkpoints instead of the trainer's default one."""
    return "in `LightningModule.configure_callbacks` will override" not in record.getMessage()
