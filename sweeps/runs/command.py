"""What the commands of this package share: their command line, and failures of one line."""

import logging
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

from jsonargparse import ArgumentParser

from envpred.errors import UserError

# The options of `envpred fit`, which a sweep hands on: each is the name itself or starts with it and a dot.
FIT_OPTIONS = ("config", "model", "data", "trainer", "seed_everything")


def split_arguments(args: list[str]) -> tuple[list[str], list[str]]:
    """Split a command line into the sweep's own options and those of `envpred fit`.

    `-c x.yaml` and `--config x.yaml` belong to `envpred fit`; a value stays with the option before it.
    """
    ours: list[str] = []
    fit: list[str] = []
    target = ours
    for token in args:
        if token.startswith("--") or token == "-c":
            name = token.lstrip("-").split("=", 1)[0]
            target = fit if token == "-c" or name.split(".", 1)[0].removesuffix("+") in FIT_OPTIONS else ours
        target.append(token)
    return ours, fit


def run(function: Callable[..., None], args: list[str] | None) -> None:
    """Run `function` as the command `python -m <its module>`; what `envpred fit` takes comes to it as `fit`.

    A user's mistake is one line on standard error and exit code 1.  SIGTERM, by which clusters end a job, is taken like
    Ctrl-C.
    """
    module = sys.modules[function.__module__]
    name = f"sweeps.{function.__name__}"
    ours, fit = split_arguments(sys.argv[1:] if args is None else args)
    parser = ArgumentParser(prog=f"python -m {name}", description=(module.__doc__ or "").strip().splitlines()[0])
    parser.add_function_arguments(function, as_positional=False, skip={"fit"})
    parser.epilog = "options of `envpred fit` (--config, --model.*, --data.*, --trainer.*) go to every run"
    options = parser.instantiate(parser.parse_args(ours))

    def end(signum: int, frame: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # windows are counted again and again
    try:
        function(**vars(options), fit=fit)
    except UserError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print(f"{name}: interrupted; run the same command again to go on", file=sys.stderr)
        sys.exit(130)
