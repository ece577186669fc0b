"""Run the notebooks of the tutorials, and keep what they print and draw.

    python -m tools.run_notebooks [NAME ...]

Each runs in a folder of its own, so that it leaves nothing behind. It needs myst-nb and ipykernel,
which the extra `docs` installs.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"


def run(notebook: Any, folder: Path) -> None:
    """Run a notebook's cells in a folder; the outputs are put into it."""
    tools = Path(sys.executable).parent
    os.environ["PATH"] = os.pathsep.join((str(tools), os.environ["PATH"]))
    os.environ |= {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb", "PYTHONWARNINGS": "ignore"}
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=3_600, coalesce_streams=True, resources=where).execute()


def plain(text: str) -> str:
    """Leave out what a terminal shows for a moment: colours, bars and spinners."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    lines = (line for line in text.splitlines() if not re.search("[━⠀-⣿]", line))
    return "\n".join(lines).strip("\n") + "\n"


def main(names: list[str]) -> None:
    """Run some notebooks, or all."""
    paths = [FOLDER / f"{name}.ipynb" for name in names] or sorted(FOLDER.glob("*.ipynb"))
    for path in paths:
        notebook = nbformat.read(path, as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            run(notebook, Path(folder))
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
            for output in cell.get("outputs", ()):
                if "text" in output:
                    output["text"] = plain(output["text"])
            if "outputs" in cell:  # a bar alone leaves nothing
                cell.outputs = [one for one in cell.outputs if one.get("text", "-").strip()]
        nbformat.write(notebook, path)
        print(path.name)


if __name__ == "__main__":
    main(sys.argv[1:])
