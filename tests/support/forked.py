"""Processes forked from one that has imported the libraries, and has done nothing else.

Importing torch, scikit-learn and SciPy anew takes some three seconds, a hundred times over.
"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
import warnings
from pathlib import Path

FORKSERVER = multiprocessing.get_context("forkserver")
FORKSERVER.set_forkserver_preload(
    [
        *(
            "torch",
            "torch._dynamo",
            "stable_baselines3",
            "sklearn.gaussian_process",
            "sklearn.mixture",
        ),
        *("sklearn.ensemble", "scipy.stats", "matplotlib.figure", "numba", "trimesh", "pytest"),
    ]
)


def run_script(script: Path, *paths: Path, limit_s: float = 300.0) -> str:
    """Run a script in its folder, as a reader would, and give what it printed.

    Args:
        script: The script. What it warns of as deprecated is an error.
        *paths: Folders of the module path, beside the script's own.
        limit_s: A script that takes longer fails.
    """
    printed = script.with_suffix(".printed")
    process = FORKSERVER.Process(target=_run, args=(script, printed, paths))
    process.start()
    process.join(limit_s)
    process.kill()
    process.join()
    text = printed.read_text(encoding="utf-8")
    printed.unlink()
    assert process.exitcode == 0, text
    return text


def _run(script: Path, printed: Path, paths: tuple[Path, ...]) -> None:
    output = os.open(printed, os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.chdir(script.parent)
    added = [str(path) for path in (script.parent, *paths)]
    sys.path[:0] = added
    os.environ["PYTHONPATH"] = os.pathsep.join(added[1:])  # for processes that it starts
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.argv = [str(script)]
    warnings.filterwarnings("error", category=DeprecationWarning, module="__main__")
    runpy.run_path(str(script), run_name="__main__")
