"""Commands that take long, killed at random moments: nothing lost, nothing wrong, nobody left running.

$ENVPRED_FAULTS (`make faults N=20`) is how often each is killed by each signal, by default once.
"""

import os
import random
from pathlib import Path

import pytest

from tests.faults.commands import COMMANDS, write_inputs
from tests.faults.kills import SIGNALS, Chains

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("ENVPRED_FAULTS", "1"))
LONG = ("paper",)  # commands of minutes: only where $ENVPRED_FAULTS asks for them


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder)
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_goes_on_as_if_nothing_had_happened(name: str, inputs: Path, tmp_path: Path) -> None:
    if name in LONG and "ENVPRED_FAULTS" not in os.environ:
        pytest.skip("takes minutes: `make faults`")
    signals = list(SIGNALS) * KILLS
    seed = random.randrange(10**6)  # other moments every time
    print(f"seed {seed}")
    chance = random.Random(seed)
    chance.shuffle(signals)
    chains = Chains(name, COMMANDS[name], inputs, tmp_path, chance)
    chains.undisturbed()
    tally = chains.run(signals)
    assert sum(tally.kills.values()) == len(signals)
    assert tally.problems == []
