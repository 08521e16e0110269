"""The curves of a report: error over the horizon, ours and published side by side, and reliability diagrams."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from envpred.pictures.grids import GREEN, GREY, ORANGE, SKY, VERMILION, figure
from envpred.report.published import CURVE_NAMES, SOURCE, STATIC, curves
from envpred.report.runs import Run
from envpred.report.tables import UNIT, methods, shown_columns

BLUE, PURPLE, BLACK = "#0072b2", "#cc79a7", "#000000"  # with those of pictures.grids: the palette of Okabe and Ito
COLOUR_OF = {"prednet": BLUE, "fcn": VERMILION, "particle": ORANGE, "moved": GREEN, STATIC: BLACK, "last_frame": BLACK}
OTHERS = (PURPLE, SKY, GREY)
STYLES = ("-", "--", "-.", ":")
MARKERS = "osD^vPX"


def looks(labels: Sequence[str]) -> dict[str, tuple[str, str, str]]:
    """Colour, line style and marker of each label: the colour tells the method, the style and marker its variant."""
    chosen: dict[str, tuple[str, str, str]] = {}
    used: dict[str, int] = {}
    others = iter(OTHERS * len(labels))
    for n, label in enumerate(labels):
        method = label.split(" ")[0]
        colour = next((c for key, c in COLOUR_OF.items() if method.lower().startswith(key)), None) or next(others)
        style = STYLES[used.get(colour, 0) % len(STYLES)]
        used[colour] = used.get(colour, 0) + 1
        chosen[label] = colour, style, MARKERS[n % len(MARKERS)]
    return chosen


def error_curves(runs: Sequence[Run]) -> Figure:
    """MSE over the horizon with bands of one standard error: ours left, the published curves apart at the right."""
    fig = figure(11, 4.4)
    ours, theirs = fig.subplots(1, 2, sharex=True)
    measured = {label: (runs[0].horizon_s, value.mean, value.standard_error) for label, value in methods(runs).items()}
    published = {CURVE_NAMES[name]: (c.horizon_s, c.mean, c.standard_error) for name, c in curves().items()}
    _bands(ours, measured)
    _bands(theirs, published)
    ours.set_title(f"measured here, {len(runs[0].data['windows'])} windows", fontsize=10)
    theirs.set_title(SOURCE, fontsize=10)
    return fig


def _bands(ax: Axes, lines: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    for label, (colour, style, marker) in looks(list(lines)).items():
        seconds, mean, error = lines[label]
        ax.plot(seconds, 1e3 * mean, style, color=colour, marker=marker, markersize=4, label=label)
        spread = np.nan_to_num(error)
        ax.fill_between(seconds, 1e3 * (mean - spread), 1e3 * (mean + spread), color=colour, alpha=0.2, linewidth=0)
    ax.set_xlabel("horizon (s)")
    ax.set_ylabel(f"MSE of probability of occupied ({UNIT})")
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)


def reliability_diagram(runs: Sequence[Run]) -> Figure | None:
    """Share of cells that were occupied over the forecast probability, at the shown horizons; None if no run tells."""
    having = [run for run in runs if run.reliability is not None]
    if not having:
        return None
    columns = shown_columns(runs[0])
    fig = figure(2.9 * len(columns), 3.4 + 0.2 * (len(having) // 4))
    axes = fig.subplots(1, len(columns), sharex=True, sharey=True, squeeze=False)[0]
    styles = looks([run.label for run in having])
    for ax, h in zip(axes, columns, strict=True):
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=1)
        for run in having:
            assert run.reliability is not None
            colour, style, marker = styles[run.label]
            x, y = run.reliability["forecast"][h], run.reliability["occupied"][h]
            ax.plot(x, y, style, color=colour, marker=marker, markersize=3, label=run.label)
        ax.set_title(f"{runs[0].horizon_s[h]:.1f} s", fontsize=10)
        ax.set_xlabel("forecast probability")
        ax.set_aspect("equal")
    axes[0].set_ylabel("share occupied")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(4, len(having)), fontsize=7)
    return fig
