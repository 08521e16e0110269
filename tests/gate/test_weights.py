"""What is known of weights without loading them."""

from pathlib import Path

import pytest

from envpred.errors import UserError
from envpred.gate import weights
from envpred.gate.weights import CONFIG, find, found, shipped


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two folders that ship."""
    for name in ("prednet", "fcn"):
        (tmp_path / name).mkdir()
        (tmp_path / name / CONFIG).touch()
    (tmp_path / "notes").mkdir()
    monkeypatch.setattr(weights, "FOLDER", tmp_path)
    return tmp_path


def test_weights_are_found_by_name_or_by_folder(two: Path) -> None:
    assert shipped() == {"fcn": two / "fcn", "prednet": two / "prednet"}
    assert find("fcn") == two / "fcn"
    assert found(str(two / "fcn"), "--weights") == two / "fcn"
    assert find("notes") is None


@pytest.mark.parametrize(("name", "hint"), [("prednett", "did you mean prednet?"), ("x", "there are fcn, prednet")])
def test_others_name_those_there_are(two: Path, name: str, hint: str) -> None:
    with pytest.raises(UserError) as refusal:
        found(name, "--weights")
    assert str(refusal.value).startswith(f"--weights {name}: no weights of this name ship, and no folder holds such")
    assert str(refusal.value).endswith(f"; {hint} (`envpred configs` lists them)")
