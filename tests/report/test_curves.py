"""The lines of a report's curves: one look and one name a method, on one scale."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.lines import Line2D

from envpred.metrics.horizon_mse import MassMSE
from envpred.models import LastFrame, MovedLastFrame, MovedLastFrameOracle, ParticleForecast, PredNetForecaster
from envpred.pictures.grids import DOUBLE
from envpred.report.curves import error_caption, error_curves, reliability_diagram
from envpred.report.labels import labelled
from envpred.report.looks import ORACLE_STYLE, kinds
from envpred.report.runs import read_runs
from envpred.results.names import PARTICLES_AS_MASS
from tests.pictures.legible import illegible
from tests.report.conftest import measured, per_window

MakeRun = Callable[..., Path]


def test_an_oracle_looks_like_none_of_the_others(make_run: MakeRun) -> None:
    runs = read_runs(
        [
            make_run(),
            make_run(PredNetForecaster, "prob_static"),
            make_run(MovedLastFrame, "dst_static", level=0.06),
            make_run(MovedLastFrameOracle, "dst_static", level=0.02),
            make_run(LastFrame, "dst_static", level=0.09),
        ]
    )
    assert kinds(runs)["Moved last frame"] == "moved"
    fig = error_curves(runs)
    lines = {str(line.get_gid()): line for line in fig.axes[0].lines}
    bound = lines.pop("Last frame, true motion")
    assert bound.get_linestyle() == ORACLE_STYLE
    assert bound.get_marker() == ""
    assert len(lines) == 4
    assert all(line.get_linestyle() != ORACLE_STYLE and line.get_marker() for line in lines.values())
    assert lines["PredNet, DST static"].get_color() == lines["PredNet, probability static"].get_color()
    assert "Last frame, true motion †" in [text.get_text() for text in fig.legends[0].get_texts()]
    assert "† An oracle reads the future" in error_caption(runs)


def test_a_method_looks_the_same_here_and_as_published(all_runs: list[Path]) -> None:
    fig = error_curves(read_runs(all_runs))
    ours, theirs = ({str(line.get_gid()): line for line in ax.lines} for ax in fig.axes)
    assert set(theirs) == {"PredNet, DST DOGMa", "FCN, probability DOGMa", "Particle filter", "Static"}
    assert set(theirs) < set(ours)

    def look(line: Any) -> tuple[Any, ...]:
        return line.get_color(), line.get_linestyle(), line.get_marker()

    assert {name: look(line) for name, line in theirs.items()} == {name: look(ours[name]) for name in theirs}
    lines = [look(line) for name, line in ours.items() if not name.startswith("above")]
    assert len(set(lines)) == len(lines)
    (legend,) = fig.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert sorted(names) == sorted(name for name in ours if not name.startswith("above"))  # each once, for both halves
    markers = [handle.get_marker() for handle in legend.legend_handles if isinstance(handle, Line2D)]
    assert markers == [ours[name].get_marker() for name in names]


def test_a_published_method_that_was_not_measured_has_its_own_name(make_run: MakeRun) -> None:
    _, theirs = error_curves(read_runs([make_run()])).axes
    assert {str(line.get_gid()) for line in theirs.lines} >= {"PredNet, DST DOGMa", "Particle filter", "Static"}


def test_both_halves_have_one_scale_that_the_particle_filter_does_not_set(make_run: MakeRun) -> None:
    far = make_run(ParticleForecast, "dst_dogma", level=0.9)
    runs = read_runs([make_run(), make_run(LastFrame, "dst_static", level=0.09), far])
    fig = error_curves(runs)
    left, right = fig.axes
    assert left.get_ylim() == right.get_ylim()
    assert left.get_ylim()[0] == 0
    assert 114 < left.get_ylim()[1] < 180  # the published particle filter is within
    (filtered,) = (line for line in left.lines if line.get_gid() == "above: Particle filter")
    assert np.size(filtered.get_xdata()) == 15  # at every horizon
    smallest, largest = (1e3 * run.mse.mean[k] for run in runs[2:] for k in (0, -1))
    assert left.get_title().endswith(f"above the scale: Particle filter, {smallest:.0f} to {largest:.0f}")
    assert "above" not in right.get_title()
    assert "Above the scale, as arrows and numbers say: Particle filter." in error_caption(runs)
    assert "Above the scale" not in error_caption(runs[:2])
    assert not [line for ax in error_curves(runs[:2]).axes for line in ax.lines if "above" in str(line.get_gid())]


def test_the_particle_filters_two_scores_have_two_names(make_run: MakeRun) -> None:
    def as_mass(record: dict[str, Any]) -> None:
        record["metrics"][MassMSE.name] = measured(per_window(0.1, 3), MassMSE)

    both = read_runs([make_run(), make_run(ParticleForecast, "dst_dogma", change=as_mass)])
    lines = {str(line.get_gid()): line for line in error_curves(both).axes[0].lines}
    assert not np.array_equal(lines["Particle filter"].get_ydata(), lines[PARTICLES_AS_MASS].get_ydata())
    assert f"{PARTICLES_AS_MASS}: the same forecast, scored against the mass" in error_caption(both)
    assert PARTICLES_AS_MASS not in error_caption(both[:1])


@pytest.mark.parametrize("draw", [error_curves, reliability_diagram])
def test_figures_are_as_wide_as_two_columns_and_legible(all_runs: list[Path], draw: Callable[..., Any]) -> None:
    fig = draw(read_runs(all_runs))
    assert fig.get_figwidth() == DOUBLE
    assert illegible(fig) == []
    (legend,) = fig.legends
    box = legend.get_window_extent()
    assert not any(box.overlaps(ax.get_window_extent()) for ax in fig.axes)  # off the data


def test_names_are_neither_mathematics_nor_hidden(make_run: MakeRun) -> None:
    folder = make_run()
    for name in ("_ours", "ours, $\\alpha", "50 % & {more}^2"):
        fig = error_curves(labelled(read_runs([folder]), [f"{folder}={name}"]))
        fig.canvas.draw()
        assert name in [text.get_text() for text in fig.legends[0].get_texts()]
