"""How the lines of a report's curves look: one colour a kind of method, one style and marker a method.

The colours of the kinds are of different lightness, so that a grey print tells them apart, and remain apart for people
without one kind of cone; a style and a marker beside them need no colour at all.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from envpred.report.run import Run

ORACLE = "oracle"
# From dark to light, CIE L* from 0 to 76 in steps of about 11.
COLOUR_OF = {
    **{"static": "#000000", "prednet": "#10357a", "rollout": "#6a21b2", "fcn": "#cd190a"},
    **{"moved": "#399454", ORACLE: "#a1a1a1", "particle": "#eab247"},
}
OTHERS = ("#0078ad", "#603813", "#6fb7e0", "#004d40")  # of models that are not ours
Dashes = str | tuple[int, tuple[int, ...]]
STYLES: tuple[Dashes, ...] = ("-", "--", "-.", (0, (5, 1, 1, 1, 1, 1)))
MARKERS = "osD^vPX<>hd*p8"
ORACLE_STYLE = ":"


class Look(NamedTuple):
    """How a line is drawn."""

    colour: str
    style: Dashes
    marker: str
    width: float


def kinds(runs: Sequence[Run]) -> dict[str, str]:
    """What tells the colour of each run's line, by its label: the model if it learned, else its role."""
    return {run.label: run.name if run.role == "learned" else run.role for run in runs}


def looks(kind_of: Mapping[str, str]) -> dict[str, Look]:
    """How the line of each label is drawn: the colour tells its kind, style and marker which of that kind.

    Oracles are bounds, and look like none of the others: dots without markers.
    """
    chosen: dict[str, Look] = {}
    colours, used = dict(COLOUR_OF), dict.fromkeys(kind_of.values(), 0)
    for n, (label, kind) in enumerate(kind_of.items()):
        if kind not in colours:
            colours[kind] = OTHERS[(len(colours) - len(COLOUR_OF)) % len(OTHERS)]
        style = STYLES[used[kind] % len(STYLES)]
        used[kind] += 1
        look = Look(colours[kind], style, MARKERS[n % len(MARKERS)], 1.2)
        chosen[label] = look if kind != ORACLE else Look(colours[kind], ORACLE_STYLE, "", 1.5)
    return chosen
