"""What `envpred grids` and damaged stores tell the user to do is done, in the words of the message."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.datamodules.selection import usable_drives
from envpred.errors import UserError
from envpred.store import MANIFEST, Store, StoredDrive
from tests.build import builds
from tests.drives.synthetic import write_drive
from tests.remedies import refusal, remedy

pytestmark = pytest.mark.usefixtures("no_processes")

A, B = (f"2011_09_26_drive_{number}_sync" for number in ("0001", "0002"))
FEW = ["--particles.filter.persistent=500", "--particles.filter.births=50"]
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    write_drive(root, "0001", frames=5)
    write_drive(root, "0002", frames=4, seed=1)
    return root


@pytest.fixture
def store(source: Path, tmp_path: Path) -> Path:
    main(grids(source, tmp_path / "grids"))
    return tmp_path / "grids"


def grids(source: Path, store: Path, *more: str) -> list[str]:
    return ["grids", "--source", str(source), "--store", str(store), "--grid.cells=32", *more]


def rewrite(file: Path, **changes: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text(encoding="utf-8")) | changes), encoding="utf-8")


def flip(file: Path) -> None:
    data = file.read_bytes()
    file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


def into_a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


DAMAGE: dict[str, Callable[[Path], object]] = {
    "missing; delete": lambda drive: (drive / "label.npy").unlink(),
    "is not what its manifest says": lambda drive: np.save(drive / "label.npy", np.zeros(3)),
    "content has changed": lambda drive: flip(drive / "label.npy"),
    "format 99": lambda drive: rewrite(drive / MANIFEST, format=99),
    "cannot be read as JSON": lambda drive: (drive / MANIFEST).write_text("{"),
    "manifest.json: missing": lambda drive: (drive / MANIFEST).unlink(),
    "cannot be read .Is a directory": lambda drive: into_a_folder(drive / MANIFEST),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_drive_is_deleted_and_built_again(source: Path, store: Path, what: str) -> None:
    DAMAGE[what](store / A)
    with pytest.raises(UserError, match=what) as failure:
        StoredDrive(store / A).verify()
    if "delete" in str(failure.value):
        shutil.rmtree(store / A)
    ((command,),) = remedy(failure.value)
    main([command, *grids(source, store)[1:]])
    assert builds.all_valid(store) == [A, B]


def test_a_store_whose_parameters_were_edited_is_built_again(source: Path, store: Path) -> None:
    index = json.loads((store / "store.json").read_text())
    index["groups"]["mapping"]["parameters"]["evidence"]["discount"] = 0.5
    (store / "store.json").write_text(json.dumps(index))
    said = refusal(grids(source, store))
    assert f"the parameters of mapping have changed since it was built; delete {store} and" in said
    shutil.rmtree(store)
    ((command,),) = remedy(said)
    main([command, *grids(source, store)[1:]])
    assert builds.all_valid(store) == [A, B]


def test_a_store_is_built_where_there_is_none(source: Path, tmp_path: Path) -> None:
    ((command,),) = remedy(refusal(["verify", "--store", str(tmp_path)]))
    main([command, *grids(source, tmp_path)[1:]])
    main(["verify", "--store", str(tmp_path)])


def test_a_store_without_drives_gets_some(source: Path, store: Path) -> None:
    for drive in (A, B):
        shutil.rmtree(store / drive)
    with pytest.raises(UserError, match="holds no finished drive; run `envpred grids") as failure:
        usable_drives(store)
    (command,) = remedy(failure.value)
    main([str(source) if word == "DRIVES" else word for word in command] + ["--grid.cells=32"])
    assert list(usable_drives(store)) == [A, B]


def test_other_parameters_are_forced(source: Path, store: Path) -> None:
    (force,) = remedy(refusal(grids(source, store, "--sensor=paper")))
    main(grids(source, store, "--sensor=paper", *force))
    assert Store(store).parameters("mapping")["sensor"] == "paper"


def test_another_store_is_given_where_one_cannot_be_written(source: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (option,) = remedy(refusal(grids(source, tmp_path / "file" / "grids")))
    main([*grids(source, tmp_path / "file" / "grids"), *option, str(tmp_path / "other")])
    assert builds.all_valid(tmp_path / "other") == [A, B]


def test_velocities_need_no_drives(store: Path) -> None:
    (option,) = remedy(refusal(["grids", "--store", str(store)]))
    main(["grids", "--store", str(store), *option, *FEW])
    Store(store).check([A, B], ["velocity"])


def test_stale_velocities_are_made_again(store: Path) -> None:
    main(["grids", "--store", str(store), "--dogma=true", *FEW])
    main(["grids", "--store", str(store), "--dogma=true", "--force=true", *FEW, "--particles.tau=3", f"--drives=[{B}]"])
    with pytest.raises(UserError, match=f"the dogma grids of {A} were built with other parameters") as failure:
        Store(store).check([A, B], ["velocity"])
    (command,) = remedy(failure.value)
    main([*command, *FEW, "--particles.tau=3"])
    Store(store).check([A, B], ["velocity"])


def test_drives_without_a_calibration_take_the_papers_sensor(source: Path, tmp_path: Path) -> None:
    bare = Path(shutil.copytree(source, tmp_path / "bare"))
    for file in bare.rglob("calib_*.txt"):
        file.unlink()
    # Nothing is mapped, so the store is free for other parameters.
    (option,) = remedy(refusal(grids(bare, tmp_path / "grids")).splitlines()[0])
    main(grids(bare, tmp_path / "grids", *option))
    assert builds.all_valid(tmp_path / "grids") == [A, B]


def test_matching_takes_the_grounds_frame(store: Path) -> None:
    args = ["grids", "--store", str(store), "--dogma=true", "--particles.filter.matching=1", *FEW]
    (option,) = remedy(refusal(args))
    main([*args, *option])
    assert Store(store).parameters("dogma")["filter"]["frame"] == "ground"
