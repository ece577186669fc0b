"""Processes of this package import nothing from the current folder while they start."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import sada_gym

ROOT = Path(sada_gym.__file__).parent.parent
SHADOWS = ("multiprocessing", "pickle", "selectors", "signal", "socket", "struct", "tempfile")

SCRIPT = """
import os
import sys
import numpy as np
import sada_gym
import neighbour
from sada_gym.oracle import Oracle
from sada_gym.testing.processes import in_fresh_process


def own(mu):
    return neighbour.score(mu)


def seen():
    return "PYTHONSAFEPATH" in os.environ, neighbour.__file__ is not None


if __name__ == "__main__":
    mu = np.zeros((8, 2), np.float32)
    with Oracle("SADA-Analytic-v0", budget=8, seed=0, workers=2) as oracle:
        oracle(mu)
    with Oracle(own, dimension=2, threshold=0.3, budget=8, workers=2) as oracle:
        assert (oracle(mu) == 0.25).all()
    assert in_fresh_process(seen, home=sada_gym.Application) == (False, True)
    assert "PYTHONSAFEPATH" not in os.environ
    print("done")
"""


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder whose files leave a mark when they are imported."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in SHADOWS:
        mark = folder / f"{name}.ran"
        code = f"open({str(mark)!r}, 'w').close()\nraise ImportError('{name} of the folder')\n"
        (folder / f"{name}.py").write_text(code, encoding="utf-8")
    return folder


def run(command: Sequence[str], folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONSAFEPATH", None)
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert not list(folder.glob("*.ran"))
    return done.stdout


@pytest.mark.long
@pytest.mark.parametrize("executor", ["processes", "dask"])
def test_the_command_line_leaves_the_folders_files_alone(
    hostile: Path, tmp_path: Path, executor: str
) -> None:
    if executor == "dask":
        pytest.importorskip("distributed")
    start = tmp_path / "start.py"  # as the installed command does: it has a folder of its own
    code = "from sada_gym.cli import main\nif __name__ == '__main__':\n    main()\n"
    start.write_text(code, encoding="utf-8")
    words = "attack SADA-Analytic-v0 --adversary random --budget 20 --samples 20 --workers 2"
    words += f" --executor {executor} --out"
    run([sys.executable, str(start), *words.split(), str(tmp_path / "out")], hostile)
    assert (tmp_path / "out" / "result.json").is_file()


@pytest.mark.long
def test_a_script_leaves_them_alone_and_finds_its_neighbours(hostile: Path, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    neighbour = "import numpy as np\n\n\ndef score(mu):\n    return np.full(len(mu), 0.25)\n"
    (tmp_path / "neighbour.py").write_text(neighbour, encoding="utf-8")
    assert run([sys.executable, str(tmp_path / "script.py")], hostile) == "done\n"


def test_a_variable_that_was_set_stays_set() -> None:
    program = (
        "import os\n"
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from sada_gym.evaluation.spawn import spawn_context\n"
        "with ProcessPoolExecutor(1, mp_context=spawn_context()) as pool:\n"
        "    print(pool.submit(os.getenv, 'PYTHONSAFEPATH').result())\n"
        "print(os.environ['PYTHONSAFEPATH'])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "yes"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["yes", "yes"], done.stderr
