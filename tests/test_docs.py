"""The documentation says what is so: its examples and code blocks run, what it names exists."""

from __future__ import annotations

import ast
import builtins
import importlib.util
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import typer
from forked import run_script
from stable_baselines3 import PPO

from sada_gym import adversaries, agents
from sada_gym.cli import app
from sada_gym.envs.detection.shapes import CLASSES, benchmark_shapes
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.foundations.cards import fetchable
from sada_gym.foundations.files import read_toml

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PATHS = (ROOT, ROOT / "examples")
FOLDERS = ("sada_gym", "leaderboard", "examples", "studies", "tools", "benchmarks")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NOT_RUN = "<!-- not run:"
OPTIONAL = "rl_zoo3"
"""What a page may run though no extra brings it."""
PACKAGES = {"compare_optimisers": ("optuna", "cmaes"), "fix_lunar_lander": ("Box2D",)}
"""What an example needs of the extra `examples`; without it the example is not run."""

SMALLER = (
    (
        r"(\battack\(.*\"level-set\".*)\bbudget=500\b",
        r"\1budget=40, samples=8, options={'rounds': 1, 'models': ['trees']}",
    ),
    (r"(\battack\(.*)\bbudget=500\b", r"\1budget=60, samples=20, options={'steps': 60}"),
    (r"(\bmake\(\"bbgan\", dimension=\d, seed=0)\)", r"\1, steps=60)"),
    (r"\bbudget=500\b", "budget=60"),
    (r"\bnum_envs=64\b", "num_envs=16"),
    (r"(Oracle\(\"[\w-]+\", )budget=1_000\b", r"\1budget=200"),
    (r"\bsamples=(3|20)\b", "samples=1"),
    (r"(\brun_benchmark\(.*)\breferences=", r"\1workers=1, references="),
    (r"\breplay\(\[0\.9, 0\.8, 0\.6\], 3\)", "replay([1.0, 1.0, 1.0], 3)"),
    (r"\bBUDGET = 8_192\b", "BUDGET = 1_024"),
    (
        r"\bnum_envs=16\)\)(.*\n.*n_steps=32, .*\n)(\w+)\.learn\(512\)",
        r"num_envs=4))\1\2.learn(128)",
    ),
    (r"\bTRAINING_STEPS = [\d_]+", "TRAINING_STEPS = 64"),
    (r"\bBUDGET = (500|[12]_000)\b", "BUDGET = 40"),
    (
        r"(\"level-set\", budget=BUDGET)\b",
        r"\1, samples=8, pictures=False, options={'rounds': 1, 'models': ['trees']}",
    ),
    (r"\bn_steps=(64|128),", "n_steps=4,"),
    (r"\bn_envs=\d+", "n_envs=1"),
    (r"\.learn\((60|100)_000\)", ".learn(64)"),
    (
        r"(\battack\(.*\"level-set\", )budget=1_000\b",
        r"\1budget=40, samples=8, options={'rounds': 1, 'models': ['trees']}",
    ),
    (r"\bSEEDS = 3\b", "SEEDS = 1"),
    (
        r"\badversary, budget=1_000\b",
        "adversary, budget=60, samples=20, pictures=False, "
        "options={'rounds': 1} if adversary == 'level-set' else {}",
    ),
    (r"\bbudget=0, samples=100\b", "budget=0, samples=1"),
    (r"\bmax_steps=30\b", "max_steps=5"),
)
"""Fewer queries, steps and processes; the numbers on a page are a reader's."""

everywhere = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def run(*command: str | Path, folder: Path, timeout: float = 300) -> str:
    """Run Python as a reader would, with one thread a process."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, PATHS))}
    environment |= {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def smaller(script: str) -> str:
    """Let a script do less, see `SMALLER`."""
    for shown, run_with in SMALLER:
        script = re.sub(shown, run_with, script)
    return script


def blocks(page: Path, language: str) -> Iterator[str]:
    """Return a page's code blocks of a language, less those marked as not run."""
    text = page.read_text(encoding="utf-8")
    for block in re.finditer(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        before = text[: block.start()].rstrip().rpartition("\n")[2]
        if not (language == "python" and before.startswith(NOT_RUN)):
            yield block.group(1)


def commands(page: Path) -> Iterator[list[str]]:
    """Return the commands in a page's shell blocks as words, without comments and variables."""
    for line in "".join(blocks(page, "bash")).replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
            words.pop(0)
        if words:
            yield words


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(blocks(page, "python"))], ids=lambda page: page.stem
)
def test_code_blocks_run(page: Path, tmp_path: Path) -> None:
    """All blocks of a page in order, as one script in an empty folder."""
    script = tmp_path / "page.py"
    script.write_text(smaller("\n".join(blocks(page, "python"))), encoding="utf-8")
    run_script(script, *PATHS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if len([*blocks(page, "python")]) > 1],
    ids=lambda page: page.stem,
)
def test_each_code_block_runs_alone(page: Path, tmp_path: Path) -> None:
    """Each block in a process of its own; files that a block before has written stay."""
    for number, block in enumerate(blocks(page, "python")):
        script = tmp_path / f"block_{number}.py"
        script.write_text(smaller(block), encoding="utf-8")
        run_script(script, *PATHS)


@everywhere
def test_a_code_block_names_nothing_that_stands_in_another(page: Path) -> None:
    """Also those that are not run can be pasted alone."""
    text = page.read_text(encoding="utf-8")
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        assert _unbound(block) == set(), block


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_imports_what_there_is(page: Path) -> None:
    """Also in the code blocks that are not run."""
    text = page.read_text(encoding="utf-8")
    for script in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        for node in ast.walk(ast.parse(script)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sada_gym"):
                found = importlib.import_module(str(node.module))
                lacking = [one.name for one in node.names if not hasattr(found, one.name)]
                for name in lacking:  # a module, or an error
                    importlib.import_module(f"{node.module}.{name}")


def _unbound(script: str) -> set[str]:
    """Return the names that a script uses and nowhere binds."""
    nodes = [*ast.walk(ast.parse(script))]
    names = [node for node in nodes if isinstance(node, ast.Name)]
    bound = {node.id for node in names if not isinstance(node.ctx, ast.Load)}
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            bound.add(node.name)
        elif isinstance(node, ast.arg):
            bound.add(node.arg)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            bound |= {(name.asname or name.name).partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ExceptHandler) and node.name:
            bound.add(node.name)
    return {node.id for node in names} - bound - {*dir(builtins), "__name__", "__file__"}


@everywhere
def test_no_empty_line_breaks_a_table(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        _, ruler, *_ = [*table.splitlines(), ""]
        assert re.fullmatch(r"\|([ :]*-+[ :]*\|)+", ruler), table


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example: Path, tmp_path: Path) -> None:
    text = example.read_text(encoding="utf-8")
    for package in PACKAGES.get(example.stem, ()):
        pytest.importorskip(package)
    if example.stem.startswith("test_"):
        run("-m", "pytest", "-q", "-p", "no:cacheprovider", example, folder=tmp_path)
    else:
        script = tmp_path / example.name
        script.write_text(smaller(text), encoding="utf-8")
        assert "fool" in run_script(script, *PATHS) or "before" in text


@pytest.mark.slow
@pytest.mark.timeout(1_800)
@pytest.mark.parametrize("seed", range(3))
def test_the_whole_way_fixes_an_agent(seed: int, tmp_path: Path) -> None:
    """As `docs/repair.md` says: most known failures are fixed, and hardly anything breaks."""
    printed = run(ROOT / "examples/fix_cartpole.py", str(seed), folder=tmp_path, timeout=1_700)
    shares = re.findall(r"(\d+)% of 300 uniform worlds fool the agent", printed)
    before, after = map(int, shares)
    assert after * 2 < before
    ((fixed, known),) = re.findall(r"(\d+) of (\d+) known failures are fixed", printed)
    assert int(fixed) * 2 > int(known)
    assert re.search(r"[0-2] of \d+ worlds broke: passed", printed)
    assert (tmp_path / f"runs/fix-cartpole/{seed}/before-after.png").is_file()


@pytest.mark.long
def test_the_example_application_keeps_the_contract(tmp_path: Path) -> None:
    run("-m", "sada_gym", "check", ROOT / "examples" / "own_application.py", folder=tmp_path)


@pytest.mark.long
def test_the_example_application_is_attacked_by_its_id(tmp_path: Path) -> None:
    command = "attack own_application:Braking-v0 --adversary random --samples 20 --workers 2"
    run("-m", "sada_gym", *command.split(), folder=tmp_path)
    assert list(tmp_path.rglob("result.json"))


def test_the_example_in_toml_says_what_the_one_in_python_says(tmp_path: Path) -> None:
    for name in ("lunar_lander.py", "lunar_lander.toml"):
        shutil.copy(ROOT / "examples" / name, tmp_path)
    PPO("MlpPolicy", "LunarLander-v3", seed=0, device="cpu").save(tmp_path / "lander.zip")
    in_python = runpy.run_path(str(tmp_path / "lunar_lander.py"))["make_application"]()
    in_toml = read_application(tmp_path / "lunar_lander.toml")
    assert in_toml.settings == in_python.settings
    assert in_toml.fingerprint == in_python.fingerprint
    assert in_toml.parameters.parameters == in_python.parameters.parameters


@everywhere
def test_ids_exist(page: Path) -> None:
    named = set(re.findall(r"SADA-\w+(?:-\w+)*-v\d+", page.read_text(encoding="utf-8")))
    assert named <= set(gym.registry)


@everywhere
def test_commands_parse(page: Path) -> None:
    """Their options exist, and the adversaries, agents and files that they name."""
    for program, *words in commands(page):
        if program == "sada-gym":
            _parse(words)
        elif program in ("python", "pytest") and words[0].endswith(".py"):
            assert (ROOT / words[0]).is_file()
        elif program == "python" and words[1].partition(".")[0] != OPTIONAL:
            assert importlib.util.find_spec(words[1]) is not None


def _parse(words: list[str]) -> None:
    group: Any = typer.main.get_command(app)
    with group.make_context("sada-gym", words) as context:
        name, command, rest = group.resolve_command(context, words)
        with command.make_context(name, rest, parent=context) as inner:
            given = inner.params
    if name != "submit":  # which takes any name
        assert given.get("adversary", "random") in adversaries.names()
    if name not in ("init", "regress") and given.get("agent") is not None:  # which take a file
        assert given["agent"] in {*agents.names(), *fetchable()}
    subject = given.get("subject", "")
    if subject.endswith(".py") or subject.startswith("examples/"):
        assert (ROOT / subject).is_file()


@everywhere
def test_inline_commands_and_make_targets_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    group: Any = typer.main.get_command(app)
    assert set(re.findall(r"`sada-gym ([a-z]+)", text)) <= set(group.commands)
    targets = set(re.findall(r"^([a-z-]+):", _read("Makefile"), re.MULTILINE))
    named = set(re.findall(r"`make ([a-z-]+)", text))
    named |= {words[1] for words in commands(page) if words[0] == "make"}
    assert named <= targets


@everywhere
def test_scripts_of_the_repository_are_run_as_modules(page: Path) -> None:
    """`python FOLDER/x.py` does not find the folder, which is not installed."""
    text = page.read_text(encoding="utf-8")
    folders = "studies|tools|benchmarks|leaderboard"
    assert not re.search(rf"python ({folders})/", text)
    for module in re.findall(rf"python -m\s+((?:{folders})(?:\.\w+)+)", text):
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), module


@everywhere
def test_linked_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text):
        assert (page.parent / target).exists(), target
    for target in re.findall(r"^```{(?:include|literalinclude)} (.+)$", text, re.MULTILINE):
        assert (page.parent / target).exists(), target
    for target in re.findall(r"`(examples/[\w.]+|sada_gym/[\w./]+)`", text):
        assert (ROOT / target).exists(), target


def test_the_readme_knows_what_make_attack_does() -> None:
    (example,) = re.findall(r"python (examples/\w+\.py) --out", _read("Makefile"))
    assert '"SADA-Detection-Car-v0"' in _read(example)
    names, readme = runpy.run_path(str(ROOT / example)), _read("README.md")
    assert f"{names['BUDGET']:,} queries" in readme
    for adversary in names["ATTACKS"].values():
        (row,) = re.findall(rf"^    {adversary} .*%$", readme, re.MULTILINE)
        assert row in _read("docs/index.md")


def _read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_every_class_and_style_is_documented() -> None:
    detection = _read("docs/environments/detection-worlds.md")
    for name in CLASSES:
        shapes = [shape.name.partition("/")[2] for shape in benchmark_shapes(name)]
        styles = dict.fromkeys(shape.rpartition("-")[0] for shape in shapes)
        assert f"| {name} | {', '.join(styles)} |" in detection


def test_what_installs_an_extra_is_a_line_that_works() -> None:
    """No index has the package, so it comes from a clone or a wheel, and each extra exists."""
    code = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    extras = read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"]
    for path in [*PAGES, *code]:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"pip install [^\n`]*\bsada-gym", text), path
        named = re.findall(r"install_line\([\"'](\w+)|pip install [^\n]*'\.\[(\w+)\]", text)
        assert {extra for pair in named for extra in pair if extra} <= {*extras}, path
