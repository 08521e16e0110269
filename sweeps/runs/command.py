"""What the commands of this package share: their command line, failures of one line, and what makes runs comparable."""

import logging
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

from jsonargparse import ArgumentParser

from envpred.cli.arguments import split_arguments
from envpred.errors import UserError

# Arguments of the data that decide which windows are judged; runs that differ here cannot be compared.
FIXED = ("store", "variant", "split", "train", "val", "test", "length", "given", "val_windows", "stride")


def say(line: str) -> None:
    """One line of what a command has to tell."""
    print(line, flush=True)


def run(function: Callable[..., None], args: list[str] | None, prog: str | None = None) -> None:
    """Run `function` as the command `prog`, by default `python -m <its module>`.

    What `envpred fit` takes comes to it as `fit`.  A user's mistake is one line on standard error and exit code 1.
    SIGTERM, by which clusters end a job, is taken like Ctrl-C.
    """
    module = sys.modules[function.__module__]
    described = (module.__doc__ or "").strip().splitlines()[0]
    name = prog or f"{__package__.rpartition('.')[0]}.{function.__name__}"
    ours, fit = split_arguments(sys.argv[1:] if args is None else args)
    parser = ArgumentParser(prog=prog or f"python -m {name}", description=described)
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
