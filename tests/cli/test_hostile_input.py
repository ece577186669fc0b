"""Whatever stands on the command line: a sentence and exit code 2, or it is done."""

import os
import random
import sys

import pytest
from typer.testing import CliRunner

from sada_gym.cli import app

ATTACK = ["attack", "SADA-Analytic-v0", "-a", "random", "--budget", "5", "--samples", "3"]
ATTACK += ["--workers", "1"]
SMALL = ["--track", "SADA-Analytic-v0", "--budget", "5", "--samples", "3", "--images", "0"]
BENCHMARK = ["benchmark", *SMALL, "-a", "random", "--workers", "1"]
DETECTION = ["attack", "SADA-Detection-Car-v0", "-a", "random", "--samples", "1"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with all sorts of things that are no run, no model and no module."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python's own files are no command's
    (tmp_path / "file").write_text("mine")
    (tmp_path / "weights.safetensors").write_bytes(b"\x00" * 64)
    (tmp_path / "folder.py").mkdir()
    (tmp_path / "latin.py").write_bytes(b"x = '\xe9'\n")
    (tmp_path / "broken_module.py").write_text("def (:\n")
    (tmp_path / "leaving_module.py").write_text("import sys\nsys.exit(3)\n")
    (tmp_path / "plain_module.py").write_text("Thing = 3\n")
    run = tmp_path / "odd-run"
    run.mkdir()
    (run / "attack.json").write_bytes(b"\xff")
    odd = tmp_path / "odd-benchmark"
    odd.mkdir()
    (odd / "table.txt").mkdir()
    (tmp_path / "odd-entries" / "random").mkdir(parents=True)
    (tmp_path / "odd-entries" / "random" / "entry.toml").write_bytes(b"\xff")
    (tmp_path / "odd-entries" / ".lock").touch()
    os.symlink("loop", tmp_path / "loop")
    return tmp_path


def invoke(args):
    result = CliRunner().invoke(app, args, env={"COLUMNS": "200"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise AssertionError(f"{args}: {result.exception!r}") from result.exception
    return result


WRONG = ("abc", "", "null", "128.5", "-1", "0", "1000000000", "[128]", '{"a": 1}', "true", "~/x")
KEYWORDS = [
    *(("SADA-Detection-v0", name) for name in ("object_class", "image_size", "tile", "shapes")),
    *(("SADA-Detection-v0", name) for name in ("skip_unreadable", "renderer", "labels")),
    *(("SADA-Driving-v0", "task"), ("SADA-UAV-v0", "anchors"), ("SADA-Analytic-v0", "regions")),
    *(("SADA-Digits-v0", "digit"), ("SADA-Digits-v0", "image"), ("SADA-Digits-v0", "parameters")),
    *(("SADA-Pixel-v0", "radius"), ("SADA-Pixel-v0", "tile"), ("SADA-Robot-v0", "agent")),
]


@pytest.mark.parametrize(("env_id", "keyword"), KEYWORDS)
def test_a_keyword_of_a_wrong_type_or_size_is_refused_or_does(folder, env_id, keyword):
    for text in (*WRONG, "x" * 5_000):
        result = invoke(["envs", env_id, "--env-kwargs", f"{keyword}={text}"])
        assert result.exit_code in (0, 2), text
        assert result.exit_code == 0 or result.stderr.startswith("Error: Expected "), text


@pytest.mark.parametrize(
    "args",
    [
        [*ATTACK, "--budget", "1000000000000"],
        [*ATTACK, "--budget", "1e12"],
        [*ATTACK, "--budget", "-1"],
        [*ATTACK, "--samples", "1000000000000"],
        [*ATTACK, "--workers", "1000000"],
        [*ATTACK, "--seed", "-1"],
        [*ATTACK, "--seed", "one"],
        [*ATTACK, "--out", "file"],
        [*ATTACK, "--out", "file/below"],
        [*ATTACK, "--out", "loop/below"],
        [*ATTACK, "--out", "/proc/none"],
        [*ATTACK, "--out", "x" * 300],
        [*ATTACK, "--out", "zero\0byte"],
        [*ATTACK, "--out", "odd-run", "--resume"],
        [*ATTACK, "--executor", "ray"],
        [*ATTACK, "--executor", "dask:"],
        [*ATTACK, "--executor", "dask:nonsense"],
        [*ATTACK, "--env-kwargs", "dimension=two"],
        [*ATTACK, "--env-kwargs", "dimension=1000000"],
        [*ATTACK, "--env-kwargs", "dimension=1e400"],
        [*ATTACK, "--env-kwargs", "dimension=[2]"],
        [*ATTACK, "--env-kwargs", "volume=NaN"],
        [*ATTACK, "--env-kwargs", "volume={}"],
        [*ATTACK, "--env-kwargs", "horizon=0"],
        [*ATTACK, "--env-kwargs", "render_mode=3"],
        [*ATTACK, "--env-kwargs", "application=3"],
        [*ATTACK, "--env-kwargs", "=3"],
        [*ATTACK, "--set", "steps=3"],
        [*ATTACK, "--set", "dimension=3"],
        [*ATTACK, "--set", "seed=3"],
        [*ATTACK, "--set", "name=3"],
        [*ATTACK, "-a", "svm", "--set", "pool=NaN"],
        [*ATTACK, "-a", "svm", "--set", "pool=1e999"],
        [*ATTACK, "-a", "svm", "--set", "pool=[]"],
        [*ATTACK, "-a", "bbgan", "--set", "generator=many"],
        [*ATTACK, "-a", "bbgan", "--set", "steps=-1"],
        [*ATTACK, "-a", "bbgan", "--set", "preset={}"],
        [*ATTACK, "-a", "bbgan", "--set", "log_dir=file"],
        [*ATTACK, "-a", "nowhere:Class"],
        [*ATTACK, "-a", "plain_module:Thing"],
        [*ATTACK, "-a", "plain_module:Nothing"],
        [*ATTACK, "-a", "plain_module:"],
        [*ATTACK, "-a", ":Thing"],
        [*ATTACK, "-a", "..:Thing"],
        [*ATTACK, "-a", "broken_module:Thing"],
        [*ATTACK, "-a", "leaving_module:Thing"],
        ["attack", "broken_module:Thing-v0"],
        ["attack", "leaving_module:Thing-v0"],
        ["attack", "CartPole-v1"],
        ["attack", ""],
        ["attack", "a:b:c"],
        ["attack", "Not/An/Id-v0"],
        ["attack", "SADA-Analytic-v9"],
        ["attack", "SADA-Analytic"],
        [*DETECTION, "--agent", "file"],
        [*DETECTION, "--agent", "weights.safetensors"],
        [*DETECTION, "--agent", "missing.safetensors"],
        [*DETECTION, "--agent", "folder.py"],
        [*DETECTION, "--agent", ""],
        [*DETECTION, "--env-kwargs", "object_class=unicorn"],
        [*DETECTION, "--env-kwargs", "image_size=-3"],
        [*DETECTION, "--env-kwargs", "image_size=null"],
        [*DETECTION, "--env-kwargs", "shapes=3"],
        ["check", "folder.py"],
        ["check", "latin.py"],
        ["check", "broken_module.py"],
        ["check", "leaving_module.py"],
        ["check", "plain_module.py"],
        ["envs", "SADA-Analytic-v0", "--env-kwargs", "dimension=-1"],
        [*BENCHMARK, "--budget", "1000000000000"],
        [*BENCHMARK, "--samples", "1000000000000"],
        [*BENCHMARK, "--seeds", "1000000000000"],
        [*BENCHMARK, "--workers", "1000000"],
        [*BENCHMARK, "--suite", ""],
        [*BENCHMARK, "--table", "none"],
        [*BENCHMARK, "--agent", "none"],
        [*BENCHMARK, "--out", "file"],
        [*BENCHMARK, "--out", "file/below"],
        [*BENCHMARK, "--out", "loop/below"],
        [*BENCHMARK, "--out", "odd-benchmark"],
        [*BENCHMARK, "--executor", "ray"],
        [*BENCHMARK, "-a", "broken_module:Thing"],
        [*BENCHMARK, "--references", "file"],
        ["benchmark", "--report", "--out", "file"],
        ["benchmark", "--report", "--out", "odd-benchmark"],
        ["benchmark", "--report", "--out", "odd-entries", "--entries", "odd-entries"],
        ["benchmark", "--report", "--out", "x", "--entries", "file"],
        ["benchmark", "--report", "--out", "x", "--entries", "missing"],
        ["benchmark", "--report", "--out", "x", "--entries", "loop"],
        ["benchmark", "--report", "--out", "x", "--entries", "zero\0byte"],
    ],
    ids=lambda args: " ".join(args)[-60:].replace("\0", "0"),
)
def test_each_is_a_sentence(args, folder):
    before = sorted(folder.rglob("*"))
    result = invoke(args)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    lines = result.stderr.strip().splitlines()
    assert lines
    assert lines[-1].startswith("Error: ")
    assert "[Errno" not in result.stderr
    assert sorted(folder.rglob("*")) == before


WORDS = [
    *["attack", "--help", "--version"],
    *["SADA-Analytic-v0", "toy:Toy-v0", "CartPole-v1", "Nothing-v0", "file", "folder.py"],
    *[
        "--adversary",
        "-a",
        "random",
        "memorise",
        "svm",
        "toy:Greedy",
        "plain_module:Thing",
        "ideal",
    ],
    *["--budget", "0", "3", "-7", "1e12", "9" * 30, "two", "", " ", "--samples", "--seed"],
    *["--set", "pool=3", "pool=[1]", "a", "=", "x=y=z", "steps=null", "--env-kwargs"],
    *["dimension=3", "dimension=-1", "dimension={}", "volume=2", "horizon=true", "--agent"],
    *["--out", "out", "file/below", ".", "/dev/null", "--resume", "--preset", "paper", "--report"],
    *["--track", "--table", "equal-queries", "--agent", "--seeds", "--images", "--suite"],
    *["--references", "--executor", "processes", "ray", "--", "-", "--no-such-option", "\u00e9"],
]


def random_command(rng):
    start = rng.choice([*[ATTACK] * 6, BENCHMARK, ["check"], ["envs"], ["merge"], ["--version"]])
    return [*start, *rng.choices(WORDS, k=rng.randint(1, 5))]


def check_random_commands(seeds):
    for seed in seeds:
        args = random_command(random.Random(seed))
        result = invoke(args)
        assert result.exit_code in (0, 1, 2), (args, result.output)
        assert "Traceback" not in result.output
        assert "[Errno" not in result.output


def test_a_few_random_command_lines(folder):
    check_random_commands(range(30))


@pytest.mark.slow
def test_many_random_command_lines(folder):
    check_random_commands(range(1_000, 1_300))
