"""Search spaces: what is read, what is drawn, and what is refused before the first trial."""

from pathlib import Path

import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from envpred.cli.arguments import FitArguments
from envpred.errors import UserError
from sweeps.study.sampling import sampler
from sweeps.study.space import read_space
from tests.sweeps.conftest import REPOSITORY, SPACE


def written(folder: Path, text: str) -> Path:
    file = folder / "space.yaml"
    file.write_text(text)
    return file


def drawn(file: Path, **values: object) -> dict[str, object]:
    return read_space(file).suggest(optuna.trial.FixedTrial(values))  # type: ignore[arg-type]


def test_entries_become_distributions(space_file: Path) -> None:
    entries = read_space(space_file).entries
    (rate,) = entries["model.t1_lr"].dimensions
    assert rate.distribution == FloatDistribution(1e-4, 1e-2, log=True)  # YAML itself takes 1e-4 for text
    (channels,) = entries["model.channels"].dimensions
    assert channels.distribution == CategoricalDistribution(["[4]", "[4, 4]"])
    (weight,) = entries["model.layer_weights"].dimensions
    assert weight.name == "model.layer_weights.1"


def test_whole_numbers_with_steps(tmp_path: Path) -> None:
    file = written(tmp_path, "model.t1_epochs: {type: int, low: 2, high: 8, step: 2}")
    (epochs,) = read_space(file).entries["model.t1_epochs"].dimensions
    assert epochs.distribution == IntDistribution(2, 8, step=2)


def test_lists_are_drawn_whole_and_conditions_leave_out(space_file: Path) -> None:
    given = {"model.t1_lr": 1e-3, "model.layer_weights.1": 0.5, "model.t5_lr": 2e-3}
    both = drawn(space_file, **given, **{"model.channels": "[4, 4]"})
    assert both == {
        "model.channels": [4, 4],
        "model.t1_lr": 1e-3,
        "model.layer_weights": [1.0, 0.5],
        "model.t5_lr": 2e-3,
    }
    assert "model.t5_lr" not in drawn(space_file, **given, **{"model.channels": "[4]"})


def test_a_condition_on_what_is_left_out_leaves_out_too(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        "a.a: {choices: [1, 2]}\nb.b: {choices: [1, 2], when: {a.a: 1}}\nc.c: {choices: [3], when: {b.b: [1, 2]}}",
    )
    assert drawn(file, **{"a.a": 2, "b.b": 1, "c.c": 3}) == {"a.a": 2}
    assert drawn(file, **{"a.a": 1, "b.b": 1, "c.c": 3}) == {"a.a": 1, "b.b": 1, "c.c": 3}


def test_hash_tells_spaces_apart(space_file: Path, tmp_path: Path) -> None:
    first = read_space(space_file).hash
    assert read_space(written(tmp_path, SPACE + "# a comment")).hash == first
    assert read_space(written(tmp_path, SPACE.replace("1e-2", "2e-2", 1))).hash != first
    assert read_space(written(tmp_path, SPACE.replace("[[4, 4]]}", "[[4]]}"))).hash != first


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("model.t1_lr: {low: 1, hihg: 2}", "model.t1_lr: unknown key 'hihg'; did you mean high?"),
        ("model.t1_lr: 3", "3 is no range"),
        ("model.t1_lr: {low: 1}", "needs `low` and `high`"),
        ("model.t1_lr: {low: one, high: 2}", "'one' is no number"),
        ("model.t1_lr: {low: 3, high: 2}", "model.t1_lr"),
        ("model.t1_epochs: {type: int, low: 1.5, high: 2}", "1.5 is no whole number"),
        ("model.t1_lr: {type: real, low: 1, high: 2}", "neither float nor int"),
        ("model.t1_lr: {choices: 3}", "`choices` takes a list"),
        ("model.t1_lr: {choices: [1, 2], low: 1}", "no range beside it"),
        ("model.channels: {list: [4, 4]}", "constants alone"),
        (
            "a.abc: {choices: [1]}\nb.b: {choices: [1], when: {a.abd: 1}}",
            "not searched further up; did you mean a.abc?",
        ),
        ("config: x.yaml", "names no argument"),
        ("config: {a: 1}\nmodel.t1_lr: {low: 1, high: 2}", "config: Expected str | array, got object"),
        ("model.t1_lr: {type: [int], low: 1, high: 2}", "neither float nor int"),
        ("[1, 2", "cannot be read as YAML"),
    ],
)
def test_mistakes_in_the_file_get_one_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(UserError) as error:
        read_space(written(tmp_path, text))
    assert says in str(error.value)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file_names_those_that_ship(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"nothing\.yaml: no such file.* there are fcn, prednet, prednet_schedule"):
        read_space(tmp_path / "nothing.yaml")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("model.t1_lrr: {low: 1, high: 2}", "no argument model.t1_lrr with this model; did you mean model.t1_lr?"),
        ("model.dropout: {low: 0, high: 1}", "no argument model.dropout with this model"),  # FCN's
        ("trainer.gradient_clip: {low: 1, high: 2}", "did you mean trainer.gradient_clip_val?"),
        ("data.samples: {low: 1.0, high: 2.5}", "Expected a int"),
        ("model.t1_lr: {choices: [0.1, 0.2, high]}", "Expected a float. Got value: high"),
        ("data.given: {choices: [4, 5]}", "data.given cannot be searched: trials are compared on the same windows"),
    ],
)
def test_what_fit_would_refuse_is_refused_before(tmp_path: Path, fit: FitArguments, text: str, says: str) -> None:
    with pytest.raises(UserError) as error:
        read_space(written(tmp_path, text)).check(fit)
    assert says in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_the_first_trial_draws_what_the_configuration_has(space_file: Path, fit: FitArguments) -> None:
    space = read_space(space_file)
    changed = FitArguments([*fit.args, "--model.channels=[4]", "--model.layer_weights=[1, 0.5]", "--model.t1_lr=1"])
    assert space.values_in(changed) == {
        "model.channels": "[4]",
        "model.layer_weights.1": 0.5,
        "model.t5_lr": changed.values["model.t5_lr"],
    }  # a rate of 1 is not in the space, and is drawn
    study = optuna.create_study(sampler=sampler("tpe", 0, space.values_in(changed)))
    first, second = (space.suggest(study.ask()) for _ in range(2))
    assert (first["model.channels"], first["model.layer_weights"]) == ([4], [1.0, 0.5])
    assert second["model.layer_weights"] != [1.0, 0.5]


@pytest.mark.parametrize("file", sorted((REPOSITORY / "sweeps" / "spaces").glob("*.yaml")), ids=lambda file: file.stem)
def test_spaces_that_ship_fit_their_model(file: Path, store: Path) -> None:
    space = read_space(file)
    fit = FitArguments([*(f"--config={file}" for file in space.config), f"--data.store={store}"])
    space.check(fit)
    trial = optuna.create_study(sampler=optuna.samplers.RandomSampler(0)).ask()
    config = fit.complete(space.suggest(trial))
    assert file.stem.split("_")[0] in config["model"]["class_path"].lower()
    assert space.values_in(fit).keys() == trial.params.keys()  # so the first trial is what ships
    assert set(trial.params) == {d.name for entry in space.entries.values() for d in entry.dimensions}
