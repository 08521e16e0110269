"""The curves of a report: error over the horizon, ours and published side by side, and reliability diagrams."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from envpred.horizons import in_seconds
from envpred.pictures.grids import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, figure
from envpred.report.published import CURVE_NAMES, SOURCE, STATIC, curves
from envpred.report.run import FloatArray, Run
from envpred.report.tables import FACTOR, UNIT, measured_on, methods, shown_columns

ORACLE = "oracle"
COLOUR_OF = {
    **{"prednet": BLUE, "fcn": VERMILION, "particle": ORANGE, "moved": GREEN, "rollout": PURPLE, STATIC: BLACK},
    ORACLE: GREY,
}
OTHERS = (SKY, "#8a6d3b", "#5d5d81", "#f0e442")
STYLES = ("-", "--", "-.", (0, (5, 1, 1, 1, 1, 1)))
MARKERS = "osD^vPX"
ORACLE_STYLE = ":"
KIND_OF_CURVE = {"prednet_dst_dogma": "prednet", "fcn_prob_dogma": "fcn", "particle_filter": "particle"}

Dashes = str | tuple[int, tuple[int, ...]]


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

    Oracles are bounds, and look like none of the others: thin dots without markers.
    """
    chosen: dict[str, Look] = {}
    colours, used = dict(COLOUR_OF), dict.fromkeys(kind_of.values(), 0)
    for n, (label, kind) in enumerate(kind_of.items()):
        if kind not in colours:
            colours[kind] = OTHERS[(len(colours) - len(COLOUR_OF)) % len(OTHERS)]
        style = STYLES[used[kind] % len(STYLES)]
        used[kind] += 1
        look = Look(colours[kind], style, MARKERS[n % len(MARKERS)], 1.5)
        chosen[label] = look if kind != ORACLE else Look(colours[kind], ORACLE_STYLE, "", 1.2)
    return chosen


def error_curves(runs: Sequence[Run]) -> Figure:
    """MSE over the horizon with bands of one standard error: ours left, the published curves apart at the right."""
    fig = figure(11, 4.4)
    ours, theirs = fig.subplots(1, 2, sharex=True)
    measured = {
        label: (runs[0].horizon_s, value.mean, value.standard_error if value.drive_error is None else value.drive_error)
        for label, value in methods(runs).items()
    }
    published = {CURVE_NAMES[name]: (c.horizon_s, c.mean, c.standard_error) for name, c in curves().items()}
    _bands(ours, measured, {STATIC: STATIC} | kinds(runs))
    _bands(theirs, published, {CURVE_NAMES[name]: KIND_OF_CURVE.get(name, name) for name in curves()})
    ours.set_title(f"measured here, {measured_on(runs[0])}", fontsize=10)
    theirs.set_title(SOURCE, fontsize=10)
    return fig


def _bands(
    ax: Axes, lines: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]], kind_of: Mapping[str, str]
) -> None:
    for label, look in looks({label: kind_of[label] for label in lines}).items():
        seconds, mean, error = lines[label]
        _line(ax, seconds, FACTOR * mean, look, _name(label, kind_of), 4)
        low, high = (FACTOR * (mean + sign * np.nan_to_num(error)) for sign in (-1, 1))
        ax.fill_between(seconds, low, high, color=look.colour, alpha=0.2, linewidth=0)
    ax.set_xlabel("horizon (s)")
    ax.set_ylabel(f"MSE of probability of occupied ({UNIT})")
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)


def _name(label: str, kind_of: Mapping[str, str]) -> str:
    return f"{label}, reads the future" if kind_of[label] == ORACLE else label


def _line(ax: Axes, x: FloatArray, y: FloatArray, look: Look, label: str, size: float) -> None:
    (line,) = ax.plot(x, y, color=look.colour, linestyle=look.style, linewidth=look.width, label=label)
    line.set_marker(look.marker)
    line.set_markersize(size)


def reliability_diagram(runs: Sequence[Run]) -> Figure | None:
    """Share of cells that were occupied over the forecast probability, at the shown horizons; None if no run tells."""
    having = [run for run in runs if run.reliability is not None]
    if not having:
        return None
    columns = shown_columns(runs[0])
    fig = figure(2.9 * len(columns), 3.4 + 0.2 * (len(having) // 4))
    axes = fig.subplots(1, len(columns), sharex=True, sharey=True, squeeze=False)[0]
    kind_of = kinds(having)
    styles = looks(kind_of)
    for ax, h in zip(axes, columns, strict=True):
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1)
        for run in having:
            assert run.reliability is not None
            x, y = run.reliability["forecast"][h], run.reliability["occupied"][h]
            _line(ax, x, y, styles[run.label], _name(run.label, kind_of), 3)
        ax.set_title(in_seconds(runs[0].horizon_s[h]), fontsize=10)
        ax.set_xlabel("forecast probability")
        ax.set_aspect("equal")
    axes[0].set_ylabel("share occupied")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(4, len(having)), fontsize=7)
    return fig
