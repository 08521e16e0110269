"""What is taken for a command in a message: it must be what a user would type."""

from pathlib import Path

import pytest

from tests.remedies import commands
from tests.user_errors import messages


@pytest.mark.parametrize(
    ("message", "found"),
    [
        ("a.npy: missing; delete a and run `envpred grids` again", [["grids"]]),
        (
            "g: no 'x'; make it with `envpred grids --store 'my g' --a '[b]'`",
            [["grids", "--store", "my g", "--a", "[b]"]],
        ),
        ("--data.crop 9: give at most 8", []),
        ("x, with --a 1, or not; give --b.c 12 or less", [["--b.c", "12"]]),
        ("x; give --a runs/v_0/best.ckpt (or --a none, on purpose)", [["--a", "runs/v_0/best.ckpt"], ["--a", "none"]]),
        ("x; give --a '[4, 5]', or --force to go on", [["--a", "[4, 5]"], ["--force"]]),
        ("x; fewer --a or --b", [["--a"], ["--b"]]),
        ("--a needs b: pip install 'envpred[b]'", [["pip", "install", "envpred[b]"]]),
    ],
)
def test_commands_and_options_of_a_remedy(message: str, found: list[list[str]]) -> None:
    assert commands(message) == found


def test_every_place_where_a_message_is_made_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.user_errors.REPOSITORY", tmp_path)
    (tmp_path / "a.py").write_text(
        "def f(x):\n    if x:\n        raise UserError(\n            f'{x}')\n    return UserError('b')\n"
    )
    assert messages(tmp_path / "a.py") == {range(3, 5): "a.py: UserError(f'{x}')", range(5, 6): "a.py: UserError('b')"}
