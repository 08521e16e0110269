"""The version: read from git's tags when envpred is built, and told everywhere alike."""

import importlib.metadata
import tomllib
from pathlib import Path

import pytest

import envpred
from envpred.cli import main

REPOSITORY = Path(__file__).resolve().parents[1]


def test_a_tree_without_git_has_the_version_that_is_not_installed() -> None:
    hatch = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]
    assert hatch["version"]["fallback-version"] == envpred.FALLBACK_VERSION
    assert f"version: {envpred.FALLBACK_VERSION}" in (REPOSITORY / "CITATION.cff").read_text().splitlines()
    assert f"## [{envpred.FALLBACK_VERSION}]" in (REPOSITORY / "CHANGELOG.md").read_text()


def test_what_is_not_installed_has_a_version_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = importlib.metadata.version

    def missing(name: str) -> str:
        if name == "envpred":
            raise importlib.metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    assert envpred.__version__ == envpred.FALLBACK_VERSION
    main(["--version"])
    assert capsys.readouterr().out == f"envpred {envpred.FALLBACK_VERSION}\n"
