"""What `envpred fit`, `test` and `predict` tell the user to do is done, in the words of their messages."""

import json
import shutil
from pathlib import Path

import pytest
import torch

from envpred.callbacks.pictures import Pictures
from envpred.cli import main
from envpred.cli.arguments import FitArguments
from envpred.errors import UserError
from envpred.models.loading import load_forecaster
from envpred.results.result import RESULT
from tests.drives.synthetic import write_drive
from tests.e2e.test_cli import REPOSITORY, STATIC, config, configured, small
from tests.models.trainers import LEAST
from tests.remedies import refusal, remedy
from tests.store.stores import write_store

ONE_WINDOW = ["--data.samples=1", "--data.val=[b@-20]", "--data.test=[c@-20]"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(40)) for name in ("a", "b", "c")}
    return write_store(tmp_path_factory.mktemp("remedies") / "grids", drives, cells=32, dogma=True, context=64)


@pytest.fixture(scope="module")
def trained(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a run."""
    folder = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        main(["fit", *small(store, *ONE_WINDOW, "--trainer.max_epochs=1")])
    return next(folder.rglob("best*.ckpt"))


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for hook in ("on_validation_end", "on_test_end"):
        monkeypatch.setattr(Pictures, hook, lambda *_: None)  # drawing takes longer than all else


def of(model: str, store: Path, *more: str) -> list[str]:
    return configured(config(f"model/{model}.yaml"), STATIC, store, *ONE_WINDOW, *more)


def test_checkpoints_are_those_of_a_fit(store: Path) -> None:
    """One run of `envpred fit`, as each of the messages asks, gives what all of them want."""
    torch.save({"weights": 1}, "foreign.ckpt")
    torch.save(LEAST | {"class_path": "numpy.ndarray", "hyper_parameters": {}}, "array.ckpt")
    with pytest.raises(UserError, match=r"array\.ckpt: numpy\.ndarray is no forecaster") as failure:
        load_forecaster("array.ckpt")
    asked = ["best", "nowhere.ckpt", "foreign.ckpt"]
    commands = [remedy(refusal(["test", *small(store, f"--ckpt_path={name}")])) for name in asked]
    assert commands[0] == commands[1] == commands[2] == remedy(failure.value)
    ((command,),) = commands[0]
    main([command, *small(store, *ONE_WINDOW, "--trainer.max_epochs=1")])
    main(["test", *small(store, *ONE_WINDOW, "--ckpt_path=best")])
    (checkpoint,) = Path("runs").rglob("checkpoints/best*.ckpt")
    main(["test", *small(store, *ONE_WINDOW, f"--ckpt_path={checkpoint}")])
    load_forecaster(checkpoint)


def test_weights_come_from_a_checkpoint_or_are_random_on_purpose(store: Path, trained: Path) -> None:
    shutil.copytree(next(folder for folder in trained.parents if folder.name == "runs"), "runs")
    for choice in remedy(refusal(["test", *small(store, *ONE_WINDOW)])):
        main(["test", *small(store, *ONE_WINDOW), *choice])
    (results) = sorted(Path("runs").rglob(RESULT), key=lambda file: file.stat().st_mtime)
    assert [json.loads(file.read_text())["model"]["untrained"] for file in results] == [False, True]


@pytest.mark.parametrize("change", ["--model.channels=[8]", "--data.variant=prob_static"])
def test_what_a_checkpoint_was_trained_with_is_given(store: Path, trained: Path, change: str) -> None:
    args = ["test", *small(store, *ONE_WINDOW, f"--ckpt_path={trained}", change)]
    (option,) = remedy(refusal(args))
    main([*args, *option])
    assert list(Path("runs").rglob(RESULT))


def test_how_far_a_forecaster_reaches(store: Path) -> None:
    args = ["test", *of("particle_forecast", store), "--data.test=[c]", "--data.length=25"]
    (option,) = remedy(refusal(args))
    main([*args, *option])


def test_the_true_motion_is_that_of_the_test_windows(store: Path) -> None:
    args = ["predict", *of("moved_last_frame_oracle", store), "--data.predict=all"]
    (option,) = remedy(refusal(args))
    main([*args, *option])


def test_what_has_no_parameters_is_tested(store: Path) -> None:
    ((command,),) = remedy(refusal(["fit", *of("last_frame", store)]))
    main([command, *of("last_frame", store)])


def test_the_wide_grid_is_read_in_a_fixed_frame(store: Path) -> None:
    args = ["fit", *small(store, *ONE_WINDOW, "--data.crop=null", "--trainer.max_epochs=1", "--model.context=true")]
    (option,) = remedy(refusal(args))
    main([*args, *option])


def test_movers_are_given_up_or_get_their_velocities(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = write_drive(tmp_path / "kitti", frames=20)
    name, source = drive.name, drive.parents[1]
    grids = ["--source", str(source), "--store", "made", "--grid.cells=32", "--context=64"]
    few = ["--particles.filter.persistent=500", "--particles.filter.births=50"]
    args = ["test", *of("rollout", store), "--model.movers=true", "--model.futures=1"]
    build, without = remedy(refusal(args))
    main([*args, *without])
    from envpred.build import jobs

    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    main([*(str(REPOSITORY / word) if word.endswith(".yaml") else word for word in build), *grids, *few])
    main([*args, "--data.store=made", f"--data.val=[{name}@-7]", f"--data.test=[{name}@10-17]", "--data.length=7"])


def test_predictions_go_to_a_folder_that_is_free(store: Path) -> None:
    Path("full").mkdir()
    Path("full", "notes.txt").write_text("mine", encoding="utf-8")
    args = ["predict", *of("last_frame", store), "--predictions.folder=full"]
    ((option,),) = remedy(refusal(args))
    main([*args, f"{option}=free"])
    assert Path("free", "manifest.json").is_file()


def test_an_argument_that_there_is_not_is_looked_up(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit = FitArguments(of("last_frame", store))
    with pytest.raises(UserError, match="takes no argument zzz") as failure:
        fit.check_names(["zzz"], "space.yaml")
    (command,) = remedy(failure.value)
    with pytest.raises(SystemExit) as stop:
        main([*command, *of("last_frame", store)])
    assert not stop.value.code
    assert "augment:" in capsys.readouterr().out
