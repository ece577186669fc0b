import ast
import shutil
import subprocess
import sys
from pathlib import Path

import numba

from sada_gym.envs.uav import compiled
from sada_gym.envs.uav.referee import orders

FOLDER = Path(compiled.__file__).parent


def imported(name):
    """The modules of the racing package that one of them imports."""
    tree = ast.parse((FOLDER / f"{name}.py").read_text())
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {module.rsplit(".", 1)[1] for module in modules if ".envs.uav." in module}


def test_all_that_kernels_take_from_elsewhere_names_their_folder():
    users = {path.stem for path in FOLDER.glob("*.py") if "@kernel" in path.read_text()}
    assert {"drone", "guidance", "referee", "track"} <= users <= set(compiled.SOURCES)
    for name in compiled.SOURCES:
        assert imported(name) <= set(compiled.SOURCES), name


def test_a_change_in_any_source_is_another_folder(tmp_path):
    for name in compiled.SOURCES:
        shutil.copy(FOLDER / f"{name}.py", tmp_path)
    found = {compiled.sources_digest(tmp_path)}
    assert compiled.sources_digest() in found
    for name in compiled.SOURCES:
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("\n")
        found.add(compiled.sources_digest(tmp_path))
    assert len(found) == 1 + len(compiled.SOURCES)


def test_kernels_lie_there_and_a_users_own_do_not():
    assert compiled.sources_digest() in orders.stats.cache_path
    assert compiled.sources_digest() not in str(numba.config.CACHE_DIR)


def test_a_users_folder_is_heeded(tmp_path):
    told = "from sada_gym.envs.uav.referee import orders; print(orders.stats.cache_path)"
    answer = subprocess.run(
        [sys.executable, "-c", told],
        env={"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.startswith(str(tmp_path))
