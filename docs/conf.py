"""How Sphinx builds the documentation: `make docs`."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from PIL import Image, UnidentifiedImageError
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import sada_gym
from sada_gym.envs.images.conditions import CONDITIONS, SETS
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.figures import number
from sada_gym.foundations.lazy import load as load_object

# pages show docstrings of `studies`, which is not installed
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

project = "sada_gym"
author = "The sada_gym developers"
project_copyright = f"2026, {author}"
release = version = sada_gym.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_inline_tabs",
]
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
# notebooks keep what they printed and drew: `python -m tools.run_notebooks` runs them
nb_execution_mode = "off"

smartquotes_action = "De"  # straight quotes: what is copied from a page is code

html_theme = "furo"
pygments_dark_style = "github-dark"  # Furo's underlines the names of modules, like links
html_static_path = ["_static"]
html_css_files = ["sada.css"]
html_domain_indices = False  # an index of modules; the search finds them as well
html_title = f"sada_gym {release}"

_FIGURES = 18
"""Letters of the longest cell of a table that holds figures, such as `100 (98 to 100)`."""

_VALUE = 80
"""Letters of the longest value of a constant that the API's pages show."""

_ROOT = Path(sada_gym.__file__).resolve().parents[1]
_RECORDS = (
    "sada_gym.analyses.regression.",
    "sada_gym.analyses.replay.",
    "sada_gym.analyses.rescore.",
    "sada_gym.board.results.",
    "sada_gym.experiment.",
    "sada_gym.measures.",
    "sada_gym.run.",
)
"""Where classes are results, which only this package makes."""

default_role = "code"
# the contracts for pytest are documented where it is not installed, too
autodoc_mock_imports = [name for name in ("pytest",) if find_spec(name) is None]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"exclude-members": "model_config"}
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_numpy_docstring = False


class Docstring(SphinxDirective):
    """Show a Markdown docstring as a part of the page: an environment's is its documentation.

    The argument is `module:object`, or a module. `:only:` names headings, with commas between them,
    so that pictures can stand among the parts. `:below:` makes the headings subsections.
    """

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "only": directives.unchanged_required,
        "below": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Parse the docstring in place, with the page's own parser."""
        module, _, name = self.arguments[0].partition(":")
        documented = importlib.import_module(module)
        self.env.note_dependency(inspect.getsourcefile(documented) or "")
        text = inspect.getdoc(getattr(documented, name) if name else documented) or ""
        _, _, body = text.partition("\n\n")  # the page has a heading and a first line of its own
        if "only" in self.options:
            parts = {part.partition("\n")[0]: part for part in re.split("^## ", body, flags=re.M)}
            only = [heading.strip() for heading in self.options["only"].split(",")]
            if unknown := set(only) - parts.keys():
                raise self.error(f"Expected headings of {list(parts)}, got {sorted(unknown)}.")
            body = "\n".join(f"## {parts[heading]}" for heading in only)
        body = _with_signs(body)
        if "below" in self.options:
            body = re.sub("^## ", "### ", body, flags=re.M)
        return self.parse_text_to_nodes(body, allow_section_headings=True)


class Environment(SphinxDirective):
    """Show an environment's ids, spaces, threshold and agents as a table.

    The argument is the general id without its version. `:q:` says in a few words what Q is, and
    `:agents:` who acts where no agent is shipped.
    """

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "q": directives.unchanged_required,
        "agents": directives.unchanged_required,
    }

    def run(self) -> list[nodes.Node]:
        """Make the table from the application itself, so that it can't be out of date."""
        card = find_card(self.arguments[0])
        if card is None or "q" not in self.options:
            raise self.error("Expected the name of an application, and what its Q is as `:q:`.")
        ids = [card.id, *card.track_ids]
        # without its parts an application tells what its class declares
        applications = (
            [load_object(card.application)]
            if card.missing
            else [sada_gym.make_application(env_id) for env_id in ids]
        )
        spaces = [application.parameters for application in applications]
        sizes = sorted({len(space) for space in spaces})
        d, seen = ("d", "d + 2") if len(sizes) > 1 else (sizes[0], sizes[0] + 2)
        various = f" with d = {', '.join(map(str, sizes))}" if len(sizes) > 1 else ""
        agents = [f"`{agent.name}`: {agent.summary}" for agent in card.offered]
        rows = {
            "id": _few(ids, 5),
            "action": f"`Box(-1, 1, ({d},), float32)`{various}: {_few(spaces[0].names, 16)}",
            "observation": f"`Box(-1, 1, ({seen},), float32)`: the last μ, the last Q, and the "
            "share of the steps left",
            "reward": f"-Q. {self.options['q']}",
            "fooled": f"where Q ≤ ε = {applications[0].fooling_threshold:g}",
            "agents": self.options.get("agents", "; ".join(agents) or "none"),
        }
        if card.tasks:
            rows["training"] = f"on `{'`, `'.join(card.tasks)}`"
        for application in () if card.missing else applications:
            application.close()
        first, *others = (f"| {name} | {text} |" for name, text in rows.items())
        table = "\n".join([first, "| --- | --- |", *others])
        found = self.parse_text_to_nodes(table)
        found[0]["classes"].append("facts")
        return found


class Conditions(SphinxDirective):
    """Show the conditions of images as a table: sets, parameters, ranges and their sources."""

    def run(self) -> list[nodes.Node]:
        """Make the table from the conditions themselves."""
        lines = [
            "| condition | sets | from, to | source of the range |",
            "| --- | --- | --- | --- |",
        ]
        by_set = sorted(CONDITIONS, key=lambda name: [name not in SETS[each] for each in SETS])
        for name in by_set:
            condition = CONDITIONS[name]
            sets = ", ".join(f"`{each}`" for each in SETS if name in SETS[each] and each != "all")
            ranges = ", ".join(
                f"{each.label} {number(each.low)} to {number(each.high)} {each.unit}".strip()
                for each in condition.parameters
            )
            lines.append(f"| `{name}` | {sets or '-'} | {ranges} | {condition.source} |")
        return self.parse_text_to_nodes("\n".join(lines))


def _with_signs(text: str) -> str:
    """Write μ and ≤, which docstrings have in ASCII, but not in code."""
    signs = {"mu": "μ", "<=": "≤"}
    code = r"(```.*?```|`[^`]*`)"
    return re.sub(rf"{code}|\bmu\b|<=", lambda m: m[1] or signs[m[0]], text, flags=re.DOTALL)


def _few(names: Sequence[str], most: int) -> str:
    """List names as code, the middle ones left out where there are more than `most`."""
    quoted = [f"`{name}`" for name in names]
    return ", ".join(quoted if len(quoted) <= most else [*quoted[:2], "...", quoted[-1]])


def keep_first_line_of_markdown(*arguments: Any) -> None:
    """Leave an environment's Markdown docstring to its own page."""
    documented, lines = arguments[2], arguments[-1]
    headings = [i for i, line in enumerate(lines) if line.startswith("## ")]
    if headings:
        del lines[headings[0] :]
        below = documented.startswith(("sada_gym.evaluation", "sada_gym.StressEnv"))
        page = next((part for part in documented.split(".") if _has_page(part)), "interface")
        described = f"See :doc:`/environments/{page}` for its parameters, score and worlds."
        lines += ["Its spaces, rewards and arguments follow." if below else described, ""]


def _has_page(name: str) -> bool:
    return Path(__file__).with_name("environments").joinpath(f"{name}.md").is_file()


def leave_out_module_lines(*arguments: Any) -> None:
    """Leave out a module's line above its members: it reads like a part of what stands before."""
    what, options, lines = arguments[1], arguments[4], arguments[-1]
    if what == "module" and options.get("members") and len(list(filter(None, lines))) < 2:
        lines.clear()


def keep_sentences_whole(*arguments: Any) -> None:
    """Keep napoleon from taking the words before the first colon of an attribute for its type."""
    what, lines = arguments[1], arguments[-1]
    if what in ("attribute", "data", "property") and lines:
        lines[:0] = ["..", ""]  # an empty comment: napoleon looks at the first line alone


def shorten_signature(*arguments: Any) -> tuple[str, str | None] | None:
    """Show a function or factory that an argument has by default as `...`, and a path as a text.

    The arguments that all bindings share have a table, and nobody makes records by hand.
    """
    what, name = arguments[1:3]
    signature, returned = arguments[-2:]
    if not signature:
        return None
    record = name.startswith(_RECORDS) and len(signature) > _VALUE
    if what == "class" and (record or signature == "(*args, **kwargs)"):  # of a protocol
        return "", returned
    shared = r"\*, unit=.*?, over=None(?:, (.*))?\)$"
    signature = re.sub(shared, lambda m: (f"*, {m[1]}, " if m[1] else "") + "**shared)", signature)
    signature = signature.replace(f"PosixPath('{_ROOT}/", "PosixPath('")
    signature = re.sub(r"=<(function .*?>+|factory>)", "=...", signature)
    return re.sub(r"\bPosixPath\((.*?)\)", r"\1", signature), returned


def shorten_values(_: Sphinx, doctree: nodes.document) -> None:
    """Leave out the value of a constant that is too long to read; its docstring says what it is."""
    for signature in doctree.findall(addnodes.desc_signature):
        for part in list(signature.findall(addnodes.desc_annotation)):
            if part.astext().startswith(" = ") and len(part.astext()) > _VALUE:
                part.parent.remove(part)


def mark(app: Sphinx, doctree: nodes.document) -> None:
    """Tell the style sheet which pictures are charts on white, and which tables hold figures."""
    for image in doctree.findall(nodes.image):
        path = Path(app.srcdir, image["uri"].lstrip("/"))
        if path.suffix == ".png" and path.is_file() and _is_on_white(path):
            image["classes"].append("on-white")
    for table in doctree.findall(nodes.table):
        body = next(table.findall(nodes.tbody))
        cells = [cell.astext() for row in body for cell in row[1:]]
        if cells and max(map(len, cells)) <= _FIGURES:
            table["classes"].append("figures")


def _is_on_white(path: Path) -> bool:
    """Say whether the outermost pixels of a picture are white, nearly all of them."""
    try:
        with Image.open(path) as picture:
            grey = picture.convert("L")
    except UnidentifiedImageError:
        return False
    right, bottom = grey.width - 1, grey.height - 1
    top = [grey.getpixel((x, y)) for x in range(grey.width) for y in (0, bottom)]
    sides = [grey.getpixel((x, y)) for y in range(grey.height) for x in (0, right)]
    return sum(value > 250 for value in top + sides) > 0.9 * len(top + sides)


def setup(app: Sphinx) -> None:
    """Add what is ours."""
    app.add_directive("docstring", Docstring)
    app.add_directive("environment", Environment)
    app.add_directive("conditions", Conditions)
    app.connect("doctree-read", mark)
    app.connect("autodoc-process-docstring", keep_first_line_of_markdown)
    app.connect("doctree-read", shorten_values)
    app.connect("autodoc-process-docstring", leave_out_module_lines)
    app.connect("autodoc-process-docstring", keep_sentences_whole, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", shorten_signature)
