"""Help that loads nothing, says what commands take, and lines that name the nearest of what was mistyped."""

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from envpred.callbacks import PredictionWriter
from envpred.cli import main
from envpred.cli.completion import script
from envpred.cli.registry import COMMANDS, LIGHTNING
from envpred.cli.shipped import names
from envpred.cli.signatures import options, summary
from envpred.datamodules import GridDataModule
from envpred.mapping.geometry import GridSpec
from envpred.models import PredNetForecaster
from tests.remedies import remedy


@pytest.mark.parametrize(
    "args", [["--help"], ["--version"], ["configs"], ["fit", "--model.help"], ["completion", "bash"]]
)
def test_help_loads_nothing_that_takes_long(args: list[str]) -> None:
    code = f"import sys; from envpred.cli import main; main({args}); sys.stderr.write(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip()
    assert not {"torch", "lightning", "numba", "scipy", "matplotlib"} & set(done.stderr.split())


@pytest.mark.parametrize("command", [*LIGHTNING, *COMMANDS])
def test_every_commands_help_loads_nothing_and_says_what_it_is_for(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main([command, "--help"])
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: envpred {command} ")
    assert (LIGHTNING.get(command) or summary(COMMANDS[command].function)) in " ".join(shown.split())


@pytest.mark.parametrize("command", sorted(name for name, c in COMMANDS.items() if c.function.startswith("envpred.")))
def test_options_read_from_the_source_are_those_of_the_function(command: str) -> None:
    module, name = COMMANDS[command].function.rsplit(".", 1)
    parameters = inspect.signature(getattr(import_module(module), name)).parameters
    found = options(COMMANDS[command].function)
    assert list(dict.fromkeys(option.name.split(".")[0] for option in found)) == list(parameters)
    needed = {n for n, p in parameters.items() if p.default is inspect.Parameter.empty}
    assert {option.name for option in found if option.default is None} == needed
    assert all(option.text for option in found if "." not in option.name)


@pytest.mark.parametrize("kind", [GridDataModule, PredNetForecaster, PredictionWriter, GridSpec])
def test_options_of_classes_too(kind: type) -> None:
    found = options(f"{kind.__module__}.{kind.__qualname__}", "x.")
    assert [option.name for option in found] == [f"x.{name}" for name in inspect.signature(kind).parameters]


def test_help_shows_flags_choices_and_what_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    main(["grids", "--help"])
    shown = capsys.readouterr().out
    assert "usage: envpred grids --store PATH [options]" in shown
    assert "\n  --force  " in shown
    assert "--sensor {calibration,paper}" in shown
    assert "--grid.cells N" in shown
    main(["report", "--help"])
    assert "usage: envpred report RUNS ... --out PATH [options]" in capsys.readouterr().out


PREDNET = ["fit", "--data.store=x", "--model=PredNetForecaster"]


@pytest.mark.parametrize(
    ("args", "end"),
    [
        (["gird"], "there is no command gird; did you mean grids?"),
        (["frobnicate"], "there is no command frobnicate; `envpred --help` lists them"),
        (
            ["simulate", "--out", "x"],
            "there is no option --out; give its value alone, as `envpred simulate --help` shows",
        ),
        (["verify", "--stor", "x"], "there is no option --stor; did you mean --store?"),
        (["verify"], "--store must be given; `envpred verify --help` lists its options"),
        (["verify", "x", "--store", "y"], "there is no argument x; `envpred verify --help` lists its options"),
        (["grids", "--store=x", "--every=often"], "--every: Expected a int. Got value: often"),
        (["fit", "--modl", "x"], "there is no option --modl; did you mean --model?"),
        (["test", "--data.stor=x"], "there is no option --data.stor; did you mean --data.store?"),
        (
            ["fit", "--trainer.max_epoch=3"],
            "there is no option --trainer.max_epoch; did you mean --trainer.max_epochs?",
        ),
        (["fit", "--data.store=x", "--model=PredNetForcaster"], "did you mean PredNetForecaster?"),
        (["fit", "--data.store=x", "--model=mine.Own"], "current folder; `envpred fit --model.help` lists ours"),
        ([*PREDNET, "--model.chanels=[4]"], "PredNetForecaster has no option chanels; did you mean --model.channels?"),
        ([*PREDNET, "--model.channels=many"], "--model.channels: Expected a list. Got value: many"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_nearest(
    args: list[str], end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(args)
    said = capsys.readouterr().err.strip()
    assert said.startswith("envpred: ")
    assert said.endswith(end)
    assert "\n" not in said
    if "`" in end:
        main(*remedy(said))
        assert capsys.readouterr().out


def test_bash_completes_commands_options_and_configurations(tmp_path: Path) -> None:
    file = tmp_path / "envpred.bash"
    file.write_text(script("bash"))
    ask = (
        "source {file}; COMP_WORDS=({words}); COMP_CWORD={last}; "
        'COMP_LINE="{words}"; _shtab_envpred; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )

    def completed(*words: str) -> list[str]:
        line = ask.format(file=file, words=" ".join(words), last=len(words) - 1)
        return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True).stdout.split()

    assert completed("envpred", "gri") == ["grids"]
    assert "--data.store" in completed("envpred", "fit", "--data.st")
    assert set(completed("envpred", "test", "--config", "predn")) == {
        name for name in names("model") if name.startswith("predn")
    }
