import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

from sada_gym.envs.uav.world.referee import orders
from sada_gym.foundations import compiled

PACKAGE = Path(compiled.__file__).parents[1]
DRAWING = PACKAGE / "envs/driving/camera/drawing.py"


def names(files):
    return {file.relative_to(PACKAGE).as_posix() for file in files}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of its own: kernels use parts, parts use numbers; other.py is used by none."""
    for name, text in {
        "kernels": "from . import parts\nimport numpy\n",
        "parts": "def part():\n    from own.numbers.pi import PI\n    return PI\n",
        "numbers/__init__": "",
        "numbers/pi": "PI = 3\n",
        "other": "from own import kernels\n",
    }.items():
        file = tmp_path / "own" / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(compiled, "_PACKAGE", tmp_path / "own")
    forget()
    return tmp_path / "own"


@pytest.fixture(autouse=True)
def forget_afterwards():
    yield
    forget()


def forget():
    for function in (
        compiled.sources_digest,
        compiled.imported_sources,
        compiled.machine_code_folder,
    ):
        function.cache_clear()


def run(code, folder, **environment):
    """Run code in a process that imports the package from a folder."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


@pytest.mark.parametrize(
    ("changed", "matters"),
    [
        ("kernels", True),
        ("parts", True),
        ("numbers/pi", True),
        ("other", False),
        ("numbers/__init__", False),
    ],
)
def test_the_digest_covers_what_a_module_imports_and_no_more(package, changed, matters):
    before = compiled.sources_digest(package / "kernels.py")
    with (package / f"{changed}.py").open("a") as file:
        file.write("\nANOTHER = 1\n")
    forget()
    assert (compiled.sources_digest(package / "kernels.py") != before) == matters


def test_all_ways_to_import_are_seen(package):
    file = package / "all.py"
    file.write_text("import own.numbers.pi\nfrom .numbers import pi as p\nfrom own import parts\n")
    sources = {path.relative_to(package).as_posix() for path in compiled.imported_sources(file)}
    assert sources == {"numbers/__init__.py", "numbers/pi.py", "parts.py"}


def test_a_circle_of_imports_has_an_end(package):
    (package / "parts.py").write_text("from own import kernels\n")
    first, second = (compiled.sources_digest(package / f"{n}.py") for n in ("kernels", "parts"))
    assert first == second


def test_the_cameras_kernels_know_their_parts():
    parts = {"casting", "colours", "scenery"}
    sources = names(compiled.imported_sources(DRAWING))
    assert {f"envs/driving/camera/{part}.py" for part in parts} | {
        "foundations/compiled.py",
        "envs/pixels.py",
    } <= sources


def test_no_module_compiles_on_its_own():
    uses = re.compile(r"^(import numba|from numba)|\bnjit\b", re.MULTILINE)
    files = [file for file in PACKAGE.rglob("*.py") if uses.search(file.read_text("utf-8"))]
    assert names(files) == {"foundations/compiled.py"}


def test_kernels_lie_there_and_a_users_own_do_not():
    digest = compiled.sources_digest(PACKAGE / "envs/uav/world/referee.py")
    assert f"envs.uav.world.referee-{digest}" in orders.stats.cache_path
    assert compiled.FOLDER not in str(numba.config.CACHE_DIR)


CALL = "from mine import whole; print(whole(1.0), sum(whole.stats.cache_hits.values()))"


@pytest.fixture
def users(tmp_path):
    """A folder with a user's own module of kernels."""
    lines = (
        "from sada_gym.foundations.compiled import inlined, kernel",
        "part = inlined(lambda x: 10.0 * x)",
        "@kernel",
        "def whole(x):",
        "    return part(x) + 2.0",
    )
    (tmp_path / "mine.py").write_text("\n".join(lines))
    return tmp_path


@pytest.mark.long
def test_processes_may_compile_at_once_and_the_next_one_compiles_nothing(users):
    kept = users / "kept"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kept)}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", CALL], cwd=users, env=environment, stdout=subprocess.PIPE
        )
        for _ in range(2)
    ]
    assert [process.communicate()[0].split()[0] for process in both] == [b"12.0"] * 2
    assert run(CALL, users, NUMBA_CACHE_DIR=str(kept)).split() == ["12.0", "1"]
    assert [path.name.rpartition("-")[0] for path in (kept / compiled.FOLDER).iterdir()] == ["mine"]


def twice(x):
    return 2.0 * x


def test_where_nothing_can_be_written_it_compiles_all_the_same(monkeypatch, tmp_path):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(compiled, "_homes", lambda: [file, file / "inside"])
    forget()
    ours = compiled.kernel(twice)
    assert ours(3.0) == 6.0
    assert ours.stats.cache_path is None


def test_where_the_package_cannot_be_written_to_it_takes_the_users_folder(monkeypatch, tmp_path):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiled, "_PACKAGE", file)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    forget()
    ours = compiled.kernel(twice)
    assert ours(3.0) == 6.0
    digest = compiled.sources_digest(Path(__file__).resolve())
    folder = tmp_path / "numba" / compiled.FOLDER / f"{Path(__file__).stem}-{digest}"
    assert Path(ours.stats.cache_path).is_relative_to(folder)
    assert list(folder.rglob("*.nbc"))


def test_what_nothing_has_used_for_long_is_removed_and_the_rest_is_left(package, monkeypatch):
    home = package.parent / "kept"
    monkeypatch.setattr(compiled, "_homes", lambda: [home])
    old, recent, other = (
        home / compiled.FOLDER / f"{name}-{'0' * 15}{digit}"
        for name, digit in (("kernels", 1), ("kernels", 2), ("other", 3))
    )
    long_ago = time.time() - (compiled.UNUSED_DAYS + 1) * 86_400
    for folder in (old, recent, other):
        (folder / "inside").mkdir(parents=True)
    for folder in (old, other):
        os.utime(folder, (long_ago, long_ago))
    made = compiled.machine_code_folder(package / "kernels.py")
    assert {path.name for path in made.parent.iterdir()} == {made.name, recent.name, other.name}
    os.utime(made, (long_ago, long_ago))
    forget()
    assert compiled.machine_code_folder(package / "kernels.py") == made
    assert time.time() - made.stat().st_mtime < 3_600


def test_a_users_folder_is_heeded(tmp_path):
    code = "from sada_gym.envs.uav.world.referee import orders; print(orders.stats.cache_path)"
    answer = run(code, tmp_path, NUMBA_CACHE_DIR=str(tmp_path), PYTHONPATH=":".join(sys.path))
    assert answer.startswith(str(tmp_path))
