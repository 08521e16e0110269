"""How the lines of a report's curves look."""

from collections.abc import Callable
from pathlib import Path

from envpred.models import LastFrame, MovedLastFrame, MovedLastFrameOracle, PredNetForecaster
from envpred.report.curves import ORACLE_STYLE, error_curves, kinds, looks
from envpred.report.runs import read_runs

MakeRun = Callable[..., Path]


def test_colours_tell_the_method_and_styles_its_variant() -> None:
    kind_of = {"a": "prednet", "b": "prednet", "c": "static", "d": "mine", "e": "mine", "f": "yours", "g": "oracle"}
    found = looks(kind_of)
    colours = {label: look.colour for label, look in found.items()}
    assert colours["a"] == colours["b"]
    assert colours["d"] == colours["e"]
    assert len(set(colours.values())) == 5
    assert len({(look.colour, look.style) for look in found.values()}) == len(found)


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
    assert kinds(runs)["moved_last_frame (dst_static)"] == "moved"
    lines = {str(line.get_label()): line for line in error_curves(runs).axes[0].lines}
    bound = lines.pop("moved_last_frame_oracle (dst_static), reads the future")
    assert bound.get_linestyle() == ORACLE_STYLE
    assert bound.get_marker() == ""
    assert len(lines) == 4
    assert all(line.get_linestyle() != ORACLE_STYLE and line.get_marker() for line in lines.values())
    assert lines["prednet (dst_static)"].get_color() == lines["prednet (prob_static)"].get_color()


def test_the_published_curves_have_the_colours_of_ours(make_run: MakeRun) -> None:
    axes = error_curves(read_runs([make_run()])).axes
    ours, theirs = ({str(line.get_label()): line.get_color() for line in ax.lines} for ax in axes)
    assert theirs["PredNet (dst_dogma)"] == ours["prednet (dst_static)"]
    assert theirs["static"] == ours["static"]
    assert len(set(theirs.values())) == len(theirs) == 4
