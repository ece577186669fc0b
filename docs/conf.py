"""How Sphinx builds the documentation: `make docs`."""

from __future__ import annotations

import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import sada_gym

# pages show docstrings of `studies`, which is not installed
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

project = "sada_gym"
author = "The sada_gym developers"
project_copyright = f"2026, {author}"
release = version = sada_gym.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"sada_gym {release}"

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"exclude-members": "model_config"}
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_numpy_docstring = False


class Docstring(SphinxDirective):
    """Show a Markdown docstring as a part of the page: an environment's is its documentation.

    The argument is `module:object`, or a module.
    """

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse the docstring in place, with the page's own parser."""
        module, _, name = self.arguments[0].partition(":")
        documented = importlib.import_module(module)
        text = inspect.getdoc(getattr(documented, name) if name else documented) or ""
        _, _, body = text.partition("\n\n")  # the page has a heading and a first line of its own
        return self.parse_text_to_nodes(body, allow_section_headings=True)


def keep_first_line_of_markdown(*arguments: Any) -> None:
    """Leave an environment's Markdown docstring to its own page."""
    lines: list[str] = arguments[-1]
    headings = [i for i, line in enumerate(lines) if line.startswith("## ")]
    if headings:
        del lines[headings[0] :]
        lines += ["Its page is :doc:`/environments/index`.", ""]


def setup(app: Sphinx) -> None:
    """Add what is ours."""
    app.add_directive("docstring", Docstring)
    app.connect("autodoc-process-docstring", keep_first_line_of_markdown)
