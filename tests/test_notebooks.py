"""The tutorials' notebooks run to their end, with small budgets."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="the extra docs is not installed")
pytest.importorskip("nbclient", reason="the extra docs is not installed")

from tools.run_notebooks import FOLDER, run  # noqa: E402 - after the skips

SMALL = {"TRAINING_STEPS": 4_096, "BUDGET": 120, "SAMPLES": 20, "DRAWS": 300}
"""What the first cell of each notebook sets."""
SMALLER = {"lander": {"BUDGET": 40, "SAMPLES": 10}}
"""Landers that learnt little hover for long, three times in each world."""
NEEDS = {"lander": "Box2D", "images": "cv2"}
FAULTS = re.compile(r"Traceback|Usage: |^Expected ", re.MULTILINE)
"""What a command writes that did not do its work; IPython goes on after it."""

pytestmark = pytest.mark.long


def texts(notebook):
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            yield "".join(output.get("text", ""))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path):
    if (package := NEEDS.get(path.stem)) and find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    notebook = nbformat.read(path, as_version=4)
    (settings,) = (cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ()))
    names, _, _ = settings.source.splitlines()[-1].partition(" = ")
    budgets = {**SMALL, **SMALLER.get(path.stem, {})}
    values = [str(budgets[name]) for name in names.split(", ")]
    settings.source = f"{names} = {', '.join(values)}"
    run(notebook, tmp_path)
    assert not [text for text in texts(notebook) if FAULTS.search(text)]


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_printed(path: Path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert not [text for text in texts(notebook) if FAULTS.search(text)]
    assert any("image/png" in output.get("data", {}) for cell in code for output in cell.outputs)
