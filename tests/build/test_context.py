"""The wider grid in a store: made in the same pass, or added later without touching what is there."""

from pathlib import Path

import numpy as np
import pytest

from envpred.build.grids import build
from envpred.cli import main
from envpred.cli.commands import grids
from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.store import Store
from tests.build import builds
from tests.drives.synthetic import write_drive
from tests.remedies import remedy

pytestmark = pytest.mark.usefixtures("no_processes")

A, B = (f"2011_09_26_drive_{number}_sync" for number in ("0001", "0002"))
PARAMETERS = MappingParameters(GridSpec(cells=64))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    write_drive(root, "0001", frames=8, missing_scans={3})
    write_drive(root, "0002", frames=6, seed=1)
    return root


def arrays(store: Path) -> dict[str, np.ndarray]:
    return {
        f"{name}/{array}": np.array(drive.array(array))
        for name, drive in Store(store).drives.items()
        for array in drive.manifest["arrays"]
    }


def test_context_comes_in_the_same_pass_or_later_alike(source: Path, tmp_path: Path) -> None:
    alone, both, later = (tmp_path / name for name in ("alone", "both", "later"))
    build(source, alone, PARAMETERS)
    build(source, both, PARAMETERS, context=100)
    build(source, later, PARAMETERS)
    before = {file: (file.stat().st_ino, file.stat().st_mtime_ns) for file in later.rglob("*.npy")}
    build(source, later, PARAMETERS, context=100)
    assert {file: (file.stat().st_ino, file.stat().st_mtime_ns) for file in before} == before
    made, added, judged = arrays(both), arrays(later), arrays(alone)
    assert made.keys() == added.keys()
    assert len(made) == 2 * 7
    for name, array in made.items():
        np.testing.assert_array_equal(array, added[name])
        if name in judged:
            np.testing.assert_array_equal(array, judged[name])
    for store in (both, later):
        builds.all_valid(store)
        drive = Store(store).drives[A]
        assert (drive.context, drive.grid) == (GridSpec(100), GridSpec(64))
        Store(store).check([A, B], ["label", "context_evidence"])
    drive = Store(later).drives[A]
    fresh = drive.stretches[1][0]  # evidence starts anew after the gap
    assert drive.array("context_evidence")[fresh].max() == pytest.approx(1)
    assert ((drive.array("context_evidence")[fresh, 1] > 0) == (drive.array("context_label")[fresh] == 2)).all()


def test_context_of_one_more_drive_leaves_the_others(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    build(source, store, PARAMETERS, drives=[A], context=100)
    built = (store / A / "manifest.json").stat().st_ino
    build(source, store, PARAMETERS, context=100)
    assert (store / A / "manifest.json").stat().st_ino == built
    assert Store(store).drives[B].has("context_label")


@pytest.mark.parametrize("context", ["62", "65"])
def test_no_wider_grid_is_one_line(
    source: Path, tmp_path: Path, context: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(builds.command(source, tmp_path / "grids", "--grid.cells", "64", "--context", context)[3:])
    assert stop.value.code == 1
    (line,) = builds.lines(capsys.readouterr().err)
    assert line == f"envpred: --context {context}: give an even number of cells of at least the grid's 64"
    assert not (tmp_path / "grids").exists()


def test_other_context_is_refused_without_force(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    build(source, store, PARAMETERS, context=100)
    with pytest.raises(UserError, match=r"its context grids .*cells 100 there, 80 asked.*--force"):
        build(source, store, PARAMETERS, context=80)
    build(source, store, PARAMETERS, context=80, force=True)
    assert Store(store).drives[A].context == GridSpec(80)


def test_mapping_built_again_takes_the_context_along(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    build(source, store, PARAMETERS, context=100)
    build(source, store, MappingParameters(GridSpec(cells=64), sensor="paper"), force=True)
    drive = Store(store).drives[A]
    assert not drive.has("context_label")
    assert drive.context is None
    assert not (store / A / "context_label.npy").exists()


def test_context_of_another_recording_is_refused(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "grids"
    build(source, store, PARAMETERS)
    write_drive(tmp_path / "longer", "0001", frames=9, missing_scans={3})
    with pytest.raises(UserError, match=f"{A}: was mapped from other frames or poses"):
        build(tmp_path / "longer", store, PARAMETERS, context=100)
    builds.all_valid(store)


@pytest.mark.parametrize("array", ["context_label", "velocity", "particle_forecast"])
def test_the_command_that_a_missing_array_names_makes_it(source: Path, tmp_path: Path, array: str) -> None:
    store = tmp_path / "my grids"
    build(source, store)
    with pytest.raises(UserError) as failure:
        Store(store).drives[A].array(array)
    (command,) = remedy(failure.value)
    words = [str(source) if word == "DRIVES" else word for word in command]
    few = (
        [] if array == "context_label" else ["--particles.filter.persistent", "500", "--particles.filter.births", "50"]
    )
    main([*words, *few])
    assert all(drive.has(array) for drive in Store(store).drives.values())
    Store(store).check([A, B], [array])


def test_without_drives_there_are_velocities_alone(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="give the folder with the drives as --source"):
        grids(tmp_path / "grids")
    with pytest.raises(UserError, match="give the folder with the drives as --source"):
        grids(tmp_path / "grids", dogma=True, context=256)
