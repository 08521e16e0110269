"""The curves of a report: error over the horizon, ours and published side by side, and reliability diagrams."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from envpred.horizons import in_seconds
from envpred.metrics.horizon_mse import MassMSE
from envpred.pictures.grids import DOUBLE, GREY, SMALL, TEXT, figure
from envpred.report.looks import Look, kinds, looks
from envpred.report.published import CURVE_NAMES, PARTICLES, SOURCE, curve_of, curves
from envpred.report.published import STATIC as PUBLISHED_STATIC
from envpred.report.run import FloatArray, Measured, Run
from envpred.report.tables import FACTOR, UNIT, marked, measured_on, methods, oracle_note, oracles, shown_columns
from envpred.results.names import PARTICLES_AS_MASS, STATIC

WIDTH = 58  # letters of a line that an axis holds above it
OFF = 1.5  # times the static baseline's largest error: what errs more would flatten all other curves
# Kinds of the methods whose curves the paper has, which ours need not have.
KIND_OF_CURVE = {
    **{"prednet_dst_dogma": "prednet", "fcn_prob_dogma": "fcn", "particle_filter": "particle"},
    PUBLISHED_STATIC: "static",
}
AS_MASS = (
    f" {PARTICLES_AS_MASS}: the same forecast, scored against the mass of occupied, which is another measure than "
    "that of the other curves, and probably that of the published curve."
)


class Line(NamedTuple):
    """A curve: `mean` and standard `error` (N,) at `seconds` (N,), as axes show them."""

    seconds: FloatArray
    mean: FloatArray
    error: FloatArray


def error_curves(runs: Sequence[Run]) -> Figure:
    """MSE over the horizon with bands of one standard error: ours left, the published curves apart at the right.

    Both have one scale, and a method one look and one name in both.
    """
    ours, theirs, kind_of = _lines(runs)
    look_of, top = looks(kind_of), _top(ours, theirs, kind_of)
    names = {label: marked(label, oracles(runs)) for label in kind_of}
    fig = figure(DOUBLE, 2.8 + 0.15 * -(-len(names) // 3))
    left, right = fig.subplots(1, 2, sharex=True, sharey=True)
    for ax, lines, title in ((left, ours, f"measured here, {measured_on(runs[0])}"), (right, theirs, SOURCE)):
        _draw(ax, lines, look_of, top)
        above = [f"{label}, {line.mean.min():.0f} to {line.mean.max():.0f}" for label, line in _off(lines, top).items()]
        said = textwrap.wrap(f"above the scale: {'; '.join(above)}", WIDTH) if above else []
        ax.set_title("\n".join([title, *said]), fontsize=SMALL, parse_math=False)
    left.set_ylabel(f"MSE ({UNIT})", fontsize=TEXT)
    _legend(fig, {names[label]: look for label, look in look_of.items()}, 3)
    return fig


def error_caption(runs: Sequence[Run]) -> str:
    """What must be said below `error_curves`."""
    ours, theirs, kind_of = _lines(runs)
    top = _top(ours, theirs, kind_of)
    off = list(dict.fromkeys(label for lines in (ours, theirs) for label in _off(lines, top)))
    bands = "bands of one standard error over drives" if len(set(runs[0].drives)) > 1 else "of one drive without bands"
    caption = (
        f"Mean squared error over the horizon, {bands}. Right, what the paper "
        "published, of other drives and with standard errors over windows: compare shapes and orders, not levels."
    )
    if off:
        caption += f" Above the scale, as arrows and numbers say: {', '.join(off)}."
    return caption + AS_MASS * bool(_as_mass(runs)) + oracle_note(oracles(runs))


def _lines(runs: Sequence[Run]) -> tuple[dict[str, Line], dict[str, Line], dict[str, str]]:
    """The curves measured here and the published ones, by the names of their methods, and the kinds of all."""
    told = methods(runs) | _as_mass(runs)
    ours = {label: _line_of(runs[0], value) for label, value in told.items()}
    kind_of = {STATIC: "static"} | kinds(runs)
    kind_of = {label: kind_of.get(label, "particle") for label in ours}
    theirs = {}
    for key, curve in curves().items():
        mine = [run.label for run in runs if curve_of(run.name, run.role, run.variant) == key]
        name = mine[0] if mine else CURVE_NAMES[key]
        theirs[name] = Line(curve.horizon_s, FACTOR * curve.mean, FACTOR * curve.standard_error)
        kind_of.setdefault(name, KIND_OF_CURVE[key])
    return ours, theirs, kind_of


def _line_of(run: Run, value: Measured) -> Line:
    error = value.standard_error if value.drive_error is None else value.drive_error
    return Line(run.horizon_s, FACTOR * value.mean, FACTOR * error)


def _as_mass(runs: Sequence[Run]) -> dict[str, Measured]:
    """What the particle filter scores against the mass that it forecasts."""
    told = (run.metrics.get(MassMSE.name) for run in runs if run.name == PARTICLES)
    found = next((measured for measured in told if measured is not None), None)
    return {} if found is None else {PARTICLES_AS_MASS: found}


def _top(ours: Mapping[str, Line], theirs: Mapping[str, Line], kind_of: Mapping[str, str]) -> float:
    """The upper end of the scale, which all curves share but those that are far above the static baseline's."""
    lines = [*ours.items(), *theirs.items()]
    most = OFF * max(line.mean.max() for label, line in lines if kind_of[label] == "static")
    kept = [line for _, line in lines if line.mean.max() <= most]
    return 1.05 * max(min(float(most), float((line.mean + np.nan_to_num(line.error)).max())) for line in kept)


def _off(lines: Mapping[str, Line], top: float) -> dict[str, Line]:
    """The curves that go beyond the scale."""
    return {label: line for label, line in lines.items() if line.mean.max() > top}


def _draw(ax: Axes, lines: Mapping[str, Line], look_of: Mapping[str, Look], top: float) -> None:
    for label, (seconds, mean, error) in lines.items():
        look = look_of[label]
        _line(ax, seconds, mean, look, 3, label)
        low, high = (mean + sign * np.nan_to_num(error) for sign in (-1, 1))
        ax.fill_between(seconds, low, high, color=look.colour, alpha=0.12, linewidth=0)
    for label, line in _off(lines, top).items():
        above = line.seconds[line.mean > top]
        (arrows,) = ax.plot(above, np.full(len(above), 0.97), ls="", transform=ax.get_xaxis_transform())
        arrows.set(marker=r"$\uparrow$", markersize=7, color=look_of[label].colour, gid=f"above: {label}")
    ax.set_xlabel("horizon (s)", fontsize=TEXT)
    ax.set_ylim(0, top)
    ax.grid(alpha=0.3)
    ax.tick_params(labelsize=SMALL)


def _legend(fig: Figure, look_of: Mapping[str, Look], columns: int) -> None:
    """The names of lines, off the data."""
    handles = [
        Line2D([], [], color=look.colour, ls=look.style, lw=look.width, marker=look.marker, ms=3, label=str(n))
        for n, look in enumerate(look_of.values())
    ]
    legend = fig.legend(
        handles=handles, loc="outside lower center", ncols=columns, fontsize=SMALL, frameon=False, handlelength=3.2
    )
    # Written afterwards: names are the user's, and neither mathematics nor hidden where they begin with a line.
    for text, name in zip(legend.get_texts(), look_of, strict=True):
        text.set_parse_math(False)
        text.set_text(name)


def _line(ax: Axes, x: FloatArray, y: FloatArray, look: Look, size: float, label: str) -> None:
    (line,) = ax.plot(x, y, color=look.colour, linestyle=look.style, linewidth=look.width, gid=label)
    line.set_marker(look.marker)
    line.set_markersize(size)


def reliability_diagram(runs: Sequence[Run]) -> Figure | None:
    """Share of cells that were occupied over the forecast probability, at the shown horizons; None if no run tells."""
    having = [run for run in runs if run.reliability is not None]
    if not having:
        return None
    columns = shown_columns(runs[0])
    fig = figure(DOUBLE, 2.3 + 0.15 * -(-len(having) // 3))
    axes = fig.subplots(1, len(columns), sharex=True, sharey=True, squeeze=False)[0]
    look_of = looks(kinds(having))
    for ax, h in zip(axes, columns, strict=True):
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1)
        for run in having:
            assert run.reliability is not None
            _line(
                ax, run.reliability["forecast"][h], run.reliability["occupied"][h], look_of[run.label], 2.5, run.label
            )
        ax.set_title(in_seconds(runs[0].horizon_s[h]), fontsize=TEXT)
        ax.set_xlabel("forecast probability", fontsize=TEXT)
        ax.tick_params(labelsize=SMALL)
        ax.set_aspect("equal")
    axes[0].set_ylabel("share occupied", fontsize=TEXT)
    _legend(fig, {marked(label, oracles(runs)): look for label, look in look_of.items()}, 3)
    return fig
