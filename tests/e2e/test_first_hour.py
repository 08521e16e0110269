"""The first hour of a user, as a transcript."""

from pathlib import Path

import pytest

from tests.e2e.first_hour import SECTIONS, as_seen, commands_of, first_hour


def test_the_commands_of_the_pages_are_found_and_cut_short() -> None:
    readme, forecast, sweeps = (list(commands_of(*section)) for section in SECTIONS)
    assert readme[0] == "envpred grids --config rollout --source drives --store grids/"
    assert [command.split()[1] for command in readme] == ["grids", "test", "test", "report", "predict", "draw", "live"]
    assert [command.split()[1] for command in forecast] == ["grids", "fit", "test", "test", "report"]
    assert "--data.samples 20" in forecast[1]
    tune, fit, ablate = sweeps
    assert "--trials 3" in tune
    assert fit.startswith("envpred fit --config studies/prednet_dst_dogma/best.yaml --data.samples")
    assert ablate.endswith("--dry_run")


def test_progress_shows_as_its_last_line() -> None:
    assert as_seen(b"a\n  0%\r 50%\r100%\n\x1b[A\nend\r\n") == "a\n100%\nend"


@pytest.mark.slow
def test_every_command_of_the_first_hour_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From a wheel in a fresh environment; every step raises where a command does not end as it should."""
    with capsys.disabled():
        print()
        print(first_hour(tmp_path).table())
