"""The arguments of `envpred fit`: complete configurations, and command lines split in two."""

from pathlib import Path

import pytest
import yaml

from envpred.cli.arguments import FitArguments, as_options, names_configuration
from envpred.cli.tokens import OPTIONS, split_arguments
from envpred.errors import UserError


def test_a_complete_configuration_spells_every_default_out(fit: FitArguments) -> None:
    config = fit.complete({"model.t1_lr": 1e-5, "model.channels": [8, 16], "data.augment": False})
    model = config["model"]["init_args"]
    assert (model["t1_lr"], model["channels"], model["t1_epochs"], model["lr_drop"]) == (1e-5, [8, 16], 1, 0.1)
    assert config["data"]["augment"] is False
    assert "variant" not in model  # it follows the data's


def test_a_configuration_read_again_is_the_same(fit: FitArguments, tmp_path_factory: pytest.TempPathFactory) -> None:
    config = fit.complete({"model.t5_lr": 3e-7, "trainer.gradient_clip_val": None})
    file = tmp_path_factory.mktemp("config") / "trial.yaml"
    file.write_text(yaml.safe_dump(config))
    assert FitArguments([f"--config={file}"]).base == config == yaml.safe_load(file.read_text())


def test_defaults_give_way_to_the_command_line_and_its_files(fit: FitArguments, tmp_path: Path) -> None:
    quiet = {"pictures.every_n_epochs": 0}
    assert fit.base["pictures"] == {"windows": 2, "every_n_epochs": 1}
    assert fit.complete({}, quiet) == fit.base | {"pictures": {"windows": 2, "every_n_epochs": 0}}
    file = tmp_path / "pictures.yaml"
    file.write_text("pictures: {every_n_epochs: 4}")
    for option, every in (("--pictures.every_n_epochs=3", 3), (f"--config={file}", 4)):
        assert FitArguments([*fit.args, option]).complete({}, quiet)["pictures"]["every_n_epochs"] == every


def test_options_are_what_the_command_line_takes() -> None:
    assert as_options({"a.b": [1, 2.5], "c": None, "d": True, "e": "text", "f": 1e-7}) == [
        "--a.b=[1, 2.5]",
        "--c=null",
        "--d=true",
        "--e=text",
        "--f=1.0e-07",
    ]


def test_a_mistake_of_the_base_is_one_line(fit: FitArguments) -> None:
    with pytest.raises(UserError) as error:
        FitArguments([*fit.args, "--data.samples=many"])
    assert str(error.value).startswith("--data.samples: Expected a int")
    assert "usage" not in str(error.value)


def test_fits_options_are_told_from_others() -> None:
    ours = ["--trials", "4", "--variant", "dst", "--seed=1"]
    fit = ["--config", "a.yaml", "-c", "b.yaml", "--data.samples=5", "--model.channels", "[4,4]", "--model", "FCN"]
    more = ["--seed_everything", "2", "--trainer.callbacks+=X", "--predictions.dtype", "float32"]
    told = [
        *("--config=a.yaml", "--config=b.yaml", "--data.samples=5", "--model.channels=[4,4]", "--model=FCN"),
        *("--seed_everything=2", "--trainer.callbacks+=X", "--predictions.dtype=float32"),
    ]
    found = split_arguments([*ours[:2], *fit, *ours[2:], *more, "--dry_run"])
    assert found == (["--trials=4", "--variant=dst", "--seed=1", "--dry_run"], told)
    assert split_arguments([*fit, *more], ("trainer", "data"))[1] == ["--data.samples=5", "--trainer.callbacks+=X"]


def test_every_option_of_fit_is_known_as_one(fit: FitArguments) -> None:
    assert set(OPTIONS) == {"config", *fit.base}


def test_a_configuration_is_named_in_any_spelling() -> None:
    assert all(names_configuration([*option, "--data.seed=1"]) for option in (["-c", "a"], ["--config", "a"]))
    assert names_configuration(["--config=a"])
    assert not names_configuration(["--data.config=a", "--configs", "a"])
