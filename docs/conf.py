"""Sphinx's configuration of the pages; the reference of the command line is written from the commands themselves."""

import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(REPOSITORY)]

import envpred  # noqa: E402
from envpred.cli import help as command_help  # noqa: E402
from envpred.cli.registry import COMMANDS, LIGHTNING  # noqa: E402

project = "envpred"
author = copyright = "The envpred authors"
version = release = envpred.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.doctest", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = "envpred"
html_copy_source = False
html_theme_options = {"light_logo": "", "dark_logo": "", "footer_icons": []}
html_static_path = ["_static"]
html_css_files = ["pages.css"]
# Browsers draw MathML themselves, so that no page asks another host for a script.
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]
# The links between pages are what can be checked without a network.
linkcheck_ignore = [r"https?://(?!127\.0\.0\.1)"]

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
doctest_global_setup = "import numpy as np"


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def _write_commands(app: Sphinx) -> None:
    """The help of every command as a page, made anew with every build."""
    page = ["# Command line", "", "What `envpred COMMAND --help` prints.", ""]
    for name in (*LIGHTNING, *COMMANDS):
        parser = command_help.of_lightning(name) if name in LIGHTNING else command_help.of_command(name)
        page += [f"## envpred {name}", "", "```text", parser.format_help().rstrip(), "```", ""]
    file = Path(app.srcdir) / "commands.md"
    text = "\n".join(page)
    if not file.is_file() or file.read_text(encoding="utf-8") != text:
        file.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Register what is written here with Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("builder-inited", _write_commands)
