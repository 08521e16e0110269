"""As many kills as are asked for, and a line for each.

python -m tests.faults.campaign --commands fit,tune --kills 100 --seed 1
"""

import argparse
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.faults.commands import COMMANDS, write_inputs
from tests.faults.kills import SIGNALS, Chains, Tally


def main() -> None:
    """As many kills as are asked for, one command after another."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--kills", type=int, default=10, help="of each command by each signal")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    tally = Tally()
    base = Path(tempfile.mkdtemp(prefix="kills-"))
    write_inputs(base / "inputs")
    for name in given.commands.split(","):
        chance = random.Random(f"{name} {given.seed}")
        chains = Chains(name, COMMANDS[name], base / "inputs", base / name, chance, say_at_once, tally)
        chains.undisturbed()
        signals = list(SIGNALS) * given.kills
        chance.shuffle(signals)
        chains.run(signals)
        say_at_once(str(tally))
    if not tally.problems:
        shutil.rmtree(base)
    sys.exit(len(tally.problems) > 0)


def say_at_once(line: str) -> None:
    print(time.strftime("%H:%M:%S"), line, flush=True)


if __name__ == "__main__":
    main()
