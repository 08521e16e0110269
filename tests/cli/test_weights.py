"""Weights from a training to a folder and back: `envpred export_weights`, `--weights`, `--model.init_from`."""

import hashlib
import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import envpred
from envpred.callbacks.pictures import Pictures
from envpred.cli import main
from envpred.errors import UserError
from envpred.gate.weights import CARD, CONFIG, TENSORS, read_config, shipped
from envpred.models.weights import Weights
from envpred.report.card import card
from envpred.results.result import RESULT
from envpred.results.validations import read_validations
from tests.remedies import refusal, remedy
from tests.store.stores import write_store

QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
MODEL = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_epochs=0", "--model.t5_epochs=1"]
RUN = Path("runs/fit/prednet/dst_static/version_0")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("weights") / "grids", {name: list(range(40)) for name in "abc"})


@pytest.fixture(autouse=True)
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    for hook in ("on_validation_end", "on_test_end"):
        monkeypatch.setattr(Pictures, hook, lambda *_: None)  # drawing takes longer than all else


@pytest.fixture(scope="module")
def work(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run, weights made of it, and their test; nothing is written into it any more."""
    folder = tmp_path_factory.mktemp("work")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sys.argv", ["envpred", "fit", "--config", "mine"])
        main(["fit", *MODEL, f"--data.store={store}", "--data.samples=2", *QUIET])
        main(["export_weights", str(RUN), "--name", "mine"])
        main(["test", "--weights", "weights/mine", f"--data.store={store}", *QUIET])
        main(["test", "--model=MovedLastFrame", f"--data.store={store}", *QUIET])
        main(["export_weights", str(RUN), "--name", "mine", "--results", "runs/test"])
    return folder


@pytest.fixture
def inside(work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, in which a test is at home."""
    shutil.copytree(work, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def result(model: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(next(Path(f"runs/test/{model}").rglob(RESULT)).read_text())
    return found


def newest_result() -> Path:
    return sorted(Path("runs/test/prednet").rglob(RESULT))[-1]


def test_a_folder_of_weights_says_what_it_is(inside: Path) -> None:
    folder = Path("weights/mine")
    assert sorted(file.name for file in folder.iterdir()) == sorted([CARD, CONFIG, TENSORS])
    config = read_config(folder)
    assert hashlib.sha256((folder / TENSORS).read_bytes()).hexdigest() == config["sha256"]
    assert config["training"]["command"] == "envpred fit --config mine"
    assert config["training"]["seconds"] > 0
    assert config["training"]["val_mse"] == read_validations(RUN).validations[0]["val_mse"]
    assert (folder / CARD).read_text() == card(config)
    for told in (config["sha256"], config["training"]["revision"], "envpred fit --config mine", "moved_last_frame"):
        assert told in card(config)


def test_numbers_of_the_card_are_those_of_the_results(inside: Path) -> None:
    config, own, moved = read_config(Path("weights/mine")), result("prednet"), result("moved_last_frame")
    assert own["model"]["trained"]["weights"] == {"name": "mine", "sha256": config["sha256"]}
    assert not own["model"]["untrained"]
    rows = {row["method"]: row for row in config["measured"]}
    assert config["horizon_s"] == [0.1, 0.5, 1.0, 1.5]
    expected = {
        "static": own["metrics"]["static_mse"],
        "mine": own["metrics"]["mse"],
        "moved_last_frame": moved["metrics"]["mse"],
    }
    for method, metric in expected.items():
        assert rows[method]["mse"] == pytest.approx([metric["mean"][k] for k in (0, 4, 9, 14)], abs=1e-6)
        assert rows[method]["first"] == pytest.approx([metric["per_window"][0][k] for k in (0, 4, 9, 14)], abs=1e-6)
    share = rows["mine"]["mse"][3] / rows["static"]["mse"][3]
    assert f"{1000 * rows['mine']['mse'][3]:.1f} ({share:.2f})" in card(config)


def test_weights_forecast_as_their_checkpoint_does(inside: Path) -> None:
    ours, theirs = envpred.load_forecaster("weights/mine"), envpred.load_forecaster(next(RUN.rglob("best.ckpt")))
    seen: Any = {"frames": torch.rand(1, 5, 2, 16, 16, generator=torch.Generator().manual_seed(0))}
    torch.testing.assert_close(
        ours.forecast(seen, 3).probability, theirs.forecast(seen, 3).probability, atol=2e-3, rtol=0
    )
    assert ours.hparams == theirs.hparams
    state = Weights.read(Path("weights/mine")).state
    assert all(torch.equal(value, theirs.state_dict()[name].half().float()) for name, value in state.items())


def test_a_configuration_that_weights_left_works_again(inside: Path, store: Path) -> None:
    config = next(Path("runs/test/prednet").rglob("config.yaml"))
    assert yaml.safe_load(config.read_text())["weights"] == "weights/mine"
    for command in ("validate", "predict", "test"):
        main([command, "--config", str(config)])
    main(["fit", "--config", str(config), "--trainer.fast_dev_run=true"])  # anew


def test_training_goes_on_from_weights_and_says_whether_it_helped(
    inside: Path, store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rates = {"0.0": "training did not help, so keep weights/mine", "1e-3": "less now"}
    for n, (rate, says) in enumerate(rates.items(), 1):
        tuned = [f"--model.t5_lr={rate}", "--model.init_from=weights/mine", "--data.samples=5"]
        main(["fit", *MODEL, f"--data.store={store}", *tuned, *QUIET])
        found = read_validations(RUN.with_name(f"version_{n}"))
        assert found.initial is not None
        assert found.initial["step"] == 0
        assert found.initial["val_mse"] == pytest.approx(read_validations(RUN).validations[0]["val_mse"], rel=1e-2)
        line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("before training"))
        assert line == f"before training, weights/mine: {1000 * found.initial['val_mse']:.1f}; {line.split('; ')[1]}"
        assert says in line


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        config = json.loads((folder / CONFIG).read_text())
        change(config)
        (folder / CONFIG).write_text(json.dumps(config))

    return edit


def flip(folder: Path) -> None:
    content = bytearray((folder / TENSORS).read_bytes())
    content[-1] ^= 1
    (folder / TENSORS).write_bytes(content)


def no_tensors(folder: Path) -> None:
    content = struct.pack("<Q", 10**6) + b"{}"
    (folder / TENSORS).write_bytes(content)
    edited(lambda config: config.update(sha256=hashlib.sha256(content).hexdigest()))(folder)


DAMAGE: dict[str, tuple[str, Callable[[Path], None]]] = {
    "a bit": (r"model\.safetensors: damaged, or not what config\.json beside it tells of; install envpred again", flip),
    "no file": (r"model\.safetensors: cannot be read \(No such file", lambda f: (f / TENSORS).unlink()),
    "no weights": (r"model\.safetensors: holds no weights \(.*\); install", no_tensors),
    "a format": (r"config\.json: format 99, this version reads 1; install", edited(lambda c: c.update(format=99))),
    "a variant": (
        r"config\.json: variant: Invalid enum value 'os\.path'",
        edited(lambda c: c.update(variant="os.path")),
    ),
    "horizons": (r"config\.json: .*other horizons than horizon_s", edited(lambda c: c.update(horizon_s=[0.1]))),
    "a class": (
        r"config\.json: system is no forecaster of this version",
        edited(lambda c: c.update(forecaster="system")),
    ),
    "the base": (r"config\.json: Forecaster is no forecaster", edited(lambda c: c.update(forecaster="Forecaster"))),
    "an argument": (r"config\.json: PredNetF.* or has other arguments", edited(lambda c: c["init_args"].update(x=1))),
    "channels": (r"the network of mine's weights are not those", edited(lambda c: c["init_args"].update(channels=[8]))),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_was_damaged_or_edited_is_one_line(inside: Path, damage: str) -> None:
    says, edit = DAMAGE[damage]
    edit(Path("weights/mine"))
    with pytest.raises(UserError, match=says):
        envpred.load_forecaster("weights/mine")


def test_weights_that_do_not_fit_are_refused_before_any_work(inside: Path, store: Path, tmp_path: Path) -> None:
    args = ["test", "--weights", "weights/mine", f"--data.store={store}", *QUIET]
    message = refusal([*args, "--data.variant=prob_static"])
    assert message.startswith("the network of mine was trained with variant dst_static, the command says prob_static")
    (option,) = remedy(message)
    main([*args, "--data.variant=prob_static", *option])
    slow = write_store(tmp_path / "slow", {name: list(range(40)) for name in "abc"}, period=0.2)
    message = refusal([*args, f"--data.store={slow}"])
    assert message.startswith("the network of mine was trained on grids of 0.1 s, slow has 0.2 s") or "0.2 s" in message
    assert refusal([*args, "--ckpt_path=best"]) == "--weights weights/mine and --ckpt_path best: give one of the two"


def test_unknown_weights_name_those_there_are(inside: Path, store: Path) -> None:
    for args in (["test", "--weights", "xyz"], ["fit", *MODEL, "--model.init_from=xyz"]):
        message = refusal([*args, f"--data.store={store}", *QUIET])
        assert "xyz: no weights of this name ship" in message
        assert f"there are {', '.join(shipped()) or 'none'} (" in message
        for command in remedy(message):
            main(command)


def test_training_further_has_an_option_of_its_own(inside: Path, store: Path) -> None:
    message = refusal(["fit", "--weights", "weights/mine", f"--data.store={store}"])
    (_, option) = remedy(message)
    assert option == ["--model.init_from", "weights/mine"]
    main(["fit", *MODEL, f"--data.store={store}", "--data.samples=1", *QUIET, *option])


def test_what_cannot_be_exported_is_one_line(inside: Path, store: Path) -> None:
    message = refusal(["export_weights", "runs", "--name", "x"])
    assert "runs: no run with a best checkpoint; give the folder" in message
    assert remedy(message) == [["fit"]]  # which has made RUN
    Path("weights/other").mkdir()
    message = refusal(["export_weights", str(RUN), "--name", "other"])
    assert "weights/other: holds something else already" in message
    (name,), (out,) = remedy(message)
    main(["export_weights", str(RUN), name, "another", out, "elsewhere"])
    assert "config.json: name: holds signs that do not belong there" in refusal(
        ["export_weights", str(RUN), "--name", "a/b"]
    )
    run = ["export_weights", str(RUN), "--name", "again", "--results"]
    assert "no result of these weights beside it" in refusal([*run, "runs/test/moved_last_frame"])
    main(["test", *MODEL, f"--data.store={store}", "--ckpt_path=best", *QUIET])
    message = refusal([*run, str(newest_result())])
    assert "was not measured with these weights" in message
    (command,) = remedy(message)
    main([*command, "weights/mine", f"--data.store={store}", *QUIET])
    main(["export_weights", str(RUN), "--name", "mine", "--results", str(newest_result())])
    main(["test", "--weights=weights/mine", f"--data.store={store}", "--data.length=10", *QUIET])
    short = newest_result().parent
    shutil.copytree(short, "short")
    edit = json.loads(Path("short/result.json").read_text())
    edit["data"]["store_hash"] = "another"
    Path("short/result.json").write_text(json.dumps(edit))
    first = "runs/test/prednet/dst_static/version_0"
    assert "other horizons than the results before" in refusal([*run, f"{first},short"])
    assert not Path("weights/again").exists()


def test_a_forecaster_of_ones_own_is_handed_on_with_its_file(inside: Path) -> None:
    file = next(RUN.rglob("best.ckpt"))
    content = torch.load(file, weights_only=True)
    content["class_path"] = "mine.Mine"
    torch.save(content, file)
    assert "mine.Mine is no forecaster of envpred" in refusal(["export_weights", str(RUN), "--name", "x"])
