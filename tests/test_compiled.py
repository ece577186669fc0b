import shutil
import subprocess
import sys
from pathlib import Path

import numba

from sada_gym import compiled
from sada_gym.envs.uav.world.referee import orders

FOLDER = Path(compiled.__file__).parent / "envs/uav/world"


def test_a_change_in_any_source_is_another_folder(tmp_path):
    names = [path.stem for path in FOLDER.glob("*.py")]
    for name in names:
        shutil.copy(FOLDER / f"{name}.py", tmp_path)
    found = {compiled.sources_digest(tmp_path)}
    assert compiled.sources_digest() in found
    for name in names:
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("\n")
        found.add(compiled.sources_digest(tmp_path))
    assert len(found) == 1 + len(names)


def test_kernels_lie_there_and_a_users_own_do_not():
    assert compiled.sources_digest() in orders.stats.cache_path
    assert compiled.sources_digest() not in str(numba.config.CACHE_DIR)


def test_a_users_folder_is_heeded(tmp_path):
    told = "from sada_gym.envs.uav.world.referee import orders; print(orders.stats.cache_path)"
    answer = subprocess.run(
        [sys.executable, "-c", told],
        env={"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.startswith(str(tmp_path))
