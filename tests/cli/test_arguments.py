"""The arguments of `envpred fit`: complete configurations, and command lines split in two."""

import pytest
import yaml

from envpred.cli.arguments import FitArguments, as_options
from envpred.errors import UserError
from sweeps.runs.command import split_arguments
from sweeps.runs.trial import as_yaml


def test_a_complete_configuration_spells_every_default_out(fit: FitArguments) -> None:
    config = fit.complete({"model.t1_lr": 1e-5, "model.channels": [8, 16], "data.augment": False})
    model = config["model"]["init_args"]
    assert (model["t1_lr"], model["channels"], model["t1_epochs"], model["lr_drop"]) == (1e-5, [8, 16], 1, 0.1)
    assert config["data"]["augment"] is False
    assert "variant" not in model  # it follows the data's


def test_a_configuration_read_again_is_the_same(fit: FitArguments, tmp_path_factory: pytest.TempPathFactory) -> None:
    config = fit.complete({"model.t5_lr": 3e-7, "trainer.gradient_clip_val": None})
    file = tmp_path_factory.mktemp("config") / "trial.yaml"
    file.write_text(as_yaml(config))
    assert FitArguments([f"--config={file}"]).base == config == yaml.safe_load(file.read_text())


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
    assert str(error.value).startswith('Parser key "data.samples"')
    assert "usage" not in str(error.value)


def test_fits_options_are_told_from_ours() -> None:
    ours = ["--trials", "4", "--variant", "dst", "--seed=1"]
    fit = ["--config", "a.yaml", "-c", "b.yaml", "--data.samples=5", "--model.channels", "[4,4]"]
    more = ["--seed_everything", "2", "--trainer.callbacks+=X"]
    assert split_arguments([*ours[:2], *fit, *ours[2:], *more]) == (ours, [*fit, *more])
