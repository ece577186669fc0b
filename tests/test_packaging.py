"""What is installed from the sdist works: no checkout beside it, and all its data inside.

`make package` runs all of it, and so does `make test-all`.
"""

from __future__ import annotations

import functools
import os
import shutil
import site
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE")
FOLDERS = ("sada_gym", "tests", "examples", "benchmarks", "studies")
CODE = {".py", ".pyc"}

BUILD = """
import sys
from setuptools import build_meta
print(build_meta.build_sdist(sys.argv[1]))
"""
POLE = """
import gymnasium as gym
from pathlib import Path
from stable_baselines3 import PPO
PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=64, device="cpu").learn(64).save("pole.zip")
Path("pole.toml").write_text('''
environment = "CartPole-v1"
agent = "pole.zip"
score = ["return", 0, 500]
fooling_threshold = 0.5
[parameters]
gravity = [5.0, 20.0]
''')
"""
STEP_ALL = """
import sys
import gymnasium as gym
import sada_gym
from sada_gym.foundations.cards import cards
assert sada_gym.__file__.startswith(sys.argv[1]), sada_gym.__file__
missing = {
    i: card.missing or ("" if card.repeatable else "needs a server")
    for card in cards()
    for i in (card.id, *card.track_ids)
}
for env_id in sada_gym.env_ids():
    if missing[env_id]:
        print(env_id, missing[env_id])
        continue
    env = gym.make(env_id)
    env.reset(seed=0)
    info = env.step(env.action_space.sample() * 0)[4]
    env.close()
    print(env_id, info["score"])
"""


def run(*command: str | Path, folder: Path, **environment: str) -> str:
    """Run a command in a folder."""
    done = subprocess.run(
        [*map(str, command)],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder outside the checkout."""
    return tmp_path_factory.mktemp("packaging")


@pytest.fixture(scope="module")
def sdist(folder: Path) -> Path:
    """The sdist, built in a copy: a build in place finds what earlier ones left."""
    copy = folder / "copy"
    copy.mkdir()
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    name = run(sys.executable, "-c", BUILD, folder, folder=copy).split()[-1]
    return folder / name


@pytest.fixture(scope="module")
def wheel(sdist: Path, folder: Path) -> Path:
    """The wheel, built from the sdist."""
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder)
    run(sys.executable, "-m", "pip", "wheel", *options, sdist, folder=folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def installed(wheel: Path, folder: Path) -> Path:
    """The folder that the wheel is installed into."""
    target = folder / "installed"
    run(
        *(sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-compile"),
        *("--target", target, wheel),
        folder=folder,
    )
    return target


@functools.cache
def dependencies() -> list[str]:
    """Where the dependencies are installed."""
    folders = [*site.getsitepackages(), site.getusersitepackages()]
    return [path for path in folders if Path(path).is_dir()]


def python(installed: Path, *arguments: str | Path) -> str:
    """Run Python where the checkout can't be imported.

    With -S no .pth file is read, and so no link to the checkout that an editable install left.
    """
    path = os.pathsep.join([str(installed), *dependencies()])
    folder = installed.parent / "elsewhere"
    folder.mkdir(exist_ok=True)
    return run(sys.executable, "-S", *arguments, folder=folder, PYTHONPATH=path)


def test_every_file_that_is_no_code_is_in_the_wheel(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as file:
        inside = set(file.namelist())
    ours = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "sada_gym").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in ours if Path(name).suffix not in CODE} - inside == set()
    assert ours - inside == set()
    strangers = {name for name in inside if not name.startswith(("sada_gym/", "sada_gym-"))}
    assert strangers == set()
    kinds = {Path(name).suffix for name in inside}
    assert {".safetensors", ".npz", ".json", ".md", ".typed"} <= kinds


def test_the_sdist_is_what_the_package_is_built_from(sdist: Path) -> None:
    with tarfile.open(sdist) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "sada_gym/py.typed"} <= names
    folders = {name.partition("/")[0] for name in names if "/" in name}
    assert folders == {"sada_gym", "sada_gym.egg-info"}


@pytest.mark.timeout(1_800)  # all kernels are compiled
def test_every_id_steps_outside_the_checkout(installed: Path) -> None:
    lines = python(installed, "-c", STEP_ALL, installed).splitlines()
    import sada_gym

    assert [line.split()[0] for line in lines if line.startswith("SADA-")] == [*sada_gym.env_ids()]


@pytest.mark.timeout(1_800)  # all kernels are compiled
def test_driving_is_attacked_outside_the_checkout(installed: Path) -> None:
    command = "attack SADA-Driving-Straight-v0 --adversary random --budget 4 --samples 2 --out run"
    python(installed, installed / "bin" / "sada-gym", *command.split())
    assert (installed.parent / "elsewhere" / "run" / "result.json").is_file()


def test_a_toml_file_is_attacked_outside_the_checkout(installed: Path) -> None:
    python(installed, "-c", POLE)
    command = "attack pole.toml --adversary random --budget 8 --samples 4 --workers 2 --out pole"
    python(installed, installed / "bin" / "sada-gym", *command.split())
    assert (installed.parent / "elsewhere" / "pole" / "result.json").is_file()
