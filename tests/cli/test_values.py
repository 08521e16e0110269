"""Values that no option can have: one line that names the option, the value and its range, before any work."""

from pathlib import Path

import pytest

from envpred.datamodules import GridDataModule
from envpred.errors import UserError, check_number
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.ground import MarkovRandomField, RansacPlane
from envpred.mapping.label_grid import RayCasting
from envpred.models import FCNForecaster, PredNetForecaster
from envpred.pictures.grids import figure, save
from tests.remedies import refusal


@pytest.mark.parametrize(
    ("made", "option", "value"),
    [
        (GridSpec, "grid.cells", 7),
        (GridSpec, "grid.cells", -2),
        (GridSpec, "grid.cells", 1_000_000),
        (GridSpec, "grid.resolution", 0.0),
        (GridSpec, "grid.resolution", float("inf")),
        (EvidenceParameters, "evidence.discount", 2.0),
        (EvidenceParameters, "evidence.occupied", float("nan")),
        (RayCasting, "rays.nearest", -1.0),
        (MarkovRandomField, "ground.cell", 0.0),
        (MarkovRandomField, "ground.max_rise", -0.1),
        (RansacPlane, "ground.trials", 0),
        (RansacPlane, "ground.max_tilt", 91.0),
        (DogmaParameters, "particles.tau", -1.0),
        (DogmaParameters, "particles.occupied", 2.0),
        (lambda **of: GridDataModule(Path("grids"), **of), "data.seed", -1),
        (lambda **of: GridDataModule(Path("grids"), **of), "data.num_workers", -1),
        (lambda **of: GridDataModule(Path("grids"), **of), "data.batch_size", 0),
        (PredNetForecaster, "model.t1_lr", -1.0),
        (PredNetForecaster, "model.t5_drop_epoch", -1),
        (PredNetForecaster, "model.channels", []),
        (PredNetForecaster, "model.channels", [0]),
        (FCNForecaster, "model.width", 0.0),
        (FCNForecaster, "model.dropout", 1.5),
        (FCNForecaster, "model.horizons", 0),
    ],
    ids=lambda given: str(given) if isinstance(given, str | int | float | list) else "",
)
def test_values_beyond_their_range(made: type, option: str, value: object) -> None:
    with pytest.raises(UserError) as failure:
        made(**{option.rpartition(".")[2]: value})
    said = str(failure.value)
    shown = f"{value:g}" if isinstance(value, float) else str(value)
    assert said.startswith((f"--{option} {shown}: give ", f"--{option} {shown.replace('1000000', '1e+06')}: give "))
    assert "\n" not in said


def test_the_range_is_told() -> None:
    with pytest.raises(UserError, match=r"^--a 3: give a number of at least 0 and at most 2$"):
        check_number("a", 3, 0, 2)
    with pytest.raises(UserError, match=r"^--a 0: give a number above 0$"):
        check_number("a", 0, above=True)
    check_number("a", 2, 0, 2)
    check_number("a", 0)


def test_a_seed_that_is_none() -> None:
    args = ["test", "--model=LastFrame", "--data.store=nowhere", "--seed_everything=-1"]
    assert refusal(args) == "--seed_everything -1: give a number of at least 0 and at most 4.29497e+09"


def test_endings_that_tell_no_format(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"x\.foo: no picture that can be written; end its name on \.png"):
        save(figure(1, 1), tmp_path / "x.foo")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["--grid.cells=7", "--evidence.discount=2", "--ground.cell=0", "--workers=-1"])
def test_the_command_line_says_the_same(tmp_path: Path, option: str) -> None:
    """Whatever its parser makes of a constructor's failure; nothing is made."""
    args = ["grids", f"--source={tmp_path}", f"--store={tmp_path / 'grids'}", option]
    assert refusal(args).startswith(f"{option.replace('=', ' ')}: give ")
    assert not any(tmp_path.iterdir())
