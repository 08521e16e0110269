"""Command lines as people write them: flags without values, single names for lists, configurations by name."""

from pathlib import Path

import pytest

from envpred.cli import main
from envpred.cli.shipped import COMPLETE, find, names
from envpred.cli.signatures import Option
from envpred.cli.tokens import plain
from envpred.errors import UserError
from tests.remedies import refusal, remedy

FLAG, LIST, NUMBERS, TEXT = (
    Option("force", "bool", "False", ""),
    Option("drives", "list[str] | None", "None", ""),
    Option("horizons", "Sequence[float] | list[float]", "None", ""),
    Option("out", "Path", None, ""),
)
KNOWN = [FLAG, LIST, NUMBERS, TEXT]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--force"], ["--force=true"]),
        (["--force", "false", "--out", "x"], ["--force=false", "--out=x"]),
        (["runs/a", "--force", "runs/b"], ["runs/a", "--force=true", "runs/b"]),
        (["--drives", "a"], ["--drives=[a]"]),
        (["--drives=a,b@-20"], ["--drives=[a, b@-20]"]),
        (["--drives", "[a, b]"], ["--drives=[a, b]"]),
        (["--drives=null"], ["--drives=null"]),
        (["--drives", "0005"], ["--drives=['0005']"]),  # a name, not a number
        (["--horizons", "0.5,1"], ["--horizons=[0.5,1]"]),
        (["--model.fixed_frame", "--out", "x"], ["--model.fixed_frame=true", "--out=x"]),
        (["--out"], ["--out"]),  # its value is missing, which the parser says
        (["--model.help", "--print_config"], ["--model.help", "--print_config"]),
        (["-c", "{a: 1}"], ["--config={a: 1}"]),
        (["--trainer.callbacks+=X"], ["--trainer.callbacks+=X"]),
    ],
)
def test_what_people_write_becomes_what_parsers_take(given: list[str], expected: list[str]) -> None:
    assert plain(given, KNOWN, COMPLETE) == expected


def test_what_may_be_given_several_times_adds_up() -> None:
    given = ["a", "--label", "a=Ours, big", "--force", "--label=b=0005", "--out", "x"]
    known = [*KNOWN, Option("label", "list[str]", "[]", "")]
    expected = ["a", "--force=true", "--out=x", "--label=['a=Ours, big', b=0005]"]
    assert plain(given, known, COMPLETE, ("label",)) == expected


def test_a_configuration_that_ships_goes_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert plain(["--config", "prednet_small"], [], COMPLETE) == [f"--config={names('model')['prednet_small']}"]
    assert find("rollout", ("grids",)) == names("grids")["rollout"] != find("rollout", ("model",))
    assert find("configs/model/prednet_small.yaml", COMPLETE) == names("model")["prednet_small"]
    (tmp_path / "prednet_small").write_text("model: LastFrame")
    assert find("prednet_small", COMPLETE) == Path("prednet_small")  # a file of the user's own comes first


def test_what_does_not_ship_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(
        UserError, match=r"--config prednet_smal: no such file.*did you mean prednet_small\?"
    ) as failure:
        find("prednet_smal", COMPLETE)
    main(*remedy(failure.value))
    assert "prednet_small" in capsys.readouterr().out
    with pytest.raises(UserError, match=r"--config zzz\.yaml: no such file.*there are ground_velocity, rollout"):
        find("zzz.yaml", ("grids",))


def test_every_name_stands_for_one_configuration() -> None:
    found = [name for kind in COMPLETE for name in names(kind)]
    assert len(found) == len(set(found)) > 15


def test_a_configuration_that_is_no_text_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "picture.gif").write_bytes(b"\xff\xfe\x00\x80")
    said = refusal(["grids", f"--config={tmp_path / 'picture.gif'}"])
    assert said.startswith("a configuration names a file that holds none ('utf-8' codec can't decode")
