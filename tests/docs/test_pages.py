"""The pages in docs/: built without a network, without a warning, and looked at in a browser."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from envpred.cli.registry import COMMANDS, LIGHTNING
from tests.browser import BROWSER, browse

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = REPOSITORY / "docs"


def sphinx(builder: str, out: Path) -> Path:
    """What `builder` makes of the pages; fails on any warning."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", builder, "-d", str(out / "doctrees")]
    done = subprocess.run([*command, str(PAGES), str(out / builder)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out / builder


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("furo", reason="no Sphinx: pip install 'envpred[docs]'")
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def html(out: Path) -> Path:
    return sphinx("html", out)


def test_every_picture_and_page_that_is_linked_is_there() -> None:
    """Also in the README, and seen without Sphinx."""
    links = 0
    for page in (REPOSITORY / "README.md", *PAGES.glob("*.md")):
        if page.name == "commands.md":
            continue
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if not target.startswith("http"):
                links += 1
                assert (page.parent / target).is_file() or target in ("commands.md",), f"{page.name}: {target}"
    assert links > 40


@pytest.mark.slow
def test_links_and_examples_hold(out: Path, html: Path) -> None:
    assert (html / "index.html").is_file()
    sphinx("linkcheck", out)
    results = sphinx("doctest", out) / "output.txt"
    assert re.search(r"[1-9]\d* tests?\n\s+0 failures", results.read_text()), results.read_text()


@pytest.mark.slow
def test_every_command_and_its_options_stand_in_the_reference(html: Path) -> None:
    page = (html / "commands.html").read_text(encoding="utf-8")
    for name in (*LIGHTNING, *COMMANDS):
        assert f"<h2>envpred {name}<" in page
    assert "--particle_forecast" in page


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser: install chromium")
def test_pages_in_a_browser(html: Path, tmp_path: Path) -> None:
    """Every picture loads, nothing is wider than a phone, and nothing comes from another host."""
    pages = sorted(html.glob("*.html"))
    assert len(pages) > 10
    for page in pages:
        if page.name in ("genindex.html", "search.html"):
            continue
        seen = browse(page, tmp_path / "profile", width=400)
        assert seen["headings"], page.name
        assert all(complete and width > 0 for _, complete, width in seen["images"]), page.name
        assert all(name.startswith("file:") for name in seen["loaded"]), page.name
        assert seen["wide"] <= 0, page.name
        assert seen["errors"] == [], page.name
