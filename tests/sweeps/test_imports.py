"""`sweeps` lies beside envpred in a checkout, and inside it where it is installed: it may not know its own name."""

import ast
from pathlib import Path

import envpred
import sweeps
from tests.test_imports import imports

PACKAGE = Path(sweeps.__file__).parent


def named(file: Path) -> set[str]:
    """The first parts of what a file imports by its name."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


def test_sweeps_names_itself_nowhere() -> None:
    files = list(PACKAGE.rglob("*.py"))
    assert any(imports(file, PACKAGE) for file in files)  # they import each other nevertheless
    assert [file.name for file in files if "sweeps" in named(file)] == []


def test_envpred_knows_nothing_of_sweeps() -> None:
    for file in Path(envpred.__file__).parent.rglob("*.py"):
        assert "sweeps" not in named(file), f"{file} imports sweeps"
