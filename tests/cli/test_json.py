"""`--json`: one document on stdout, and nothing else there."""

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from sada_gym.cli import app

ATTACK = ["attack", "SADA-Analytic-v0", "-a", "random", "--budget", "30", "--samples", "12"]
NOISY = """
import os
import numpy as np
from sada_gym import Application, Parameter, ParameterSpace
from sada_gym.application import Scored


class Noisy(Application):
    name, fooling_threshold, sample_size = "Noisy", 0.3, 10
    parameters = ParameterSpace(Parameter("x", 0, 1))

    def evaluate_batch(self, mu, seeds):
        print("a word")
        os.write(1, b"a word of a library in C")
        return Scored(np.full(len(mu), 0.5), [{} for _ in mu])
"""


def document(*args, code=0):
    result = CliRunner().invoke(app, [*map(str, args), "--json"])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("json") / "run"
    return folder, document(*ATTACK, "--workers", 1, "--out", folder)


def test_an_attack_prints_its_result(run):
    folder, printed = run
    assert printed == json.loads((folder / "result.json").read_text())


def test_lists():
    ids = {row["id"]: row["keywords"] for row in document("envs")}
    assert ids["SADA-Detection-Car-v0"] == {"object_class": "car"}
    assert {"name": "photographer", "for": "SADA-Detection"}.items() <= document("agents")[
        0
    ].items()
    options = {row["name"]: row["options"] for row in document("adversaries")}
    assert options["level-set"]


def test_one_environment():
    shown = document("envs", "SADA-Analytic-v0", "--env-kwargs", "dimension=3")
    assert [one["name"] for one in shown["parameters"]] == ["x0", "x1", "x2"]
    assert shown["fooling_threshold"] == 0.3


def test_a_replay_tells_its_samples(run, tmp_path):
    printed = document("replay", run[0], "--sample", 3, "--out", tmp_path / "failure.gif")
    assert [one["sample"] for one in printed["samples"]] == [3]
    assert printed["size"] == (tmp_path / "failure.gif").stat().st_size


def test_a_plan_counts_what_is_missing(tmp_path):
    limits = ["--track", "SADA-Digits-3-v0", "-a", "random", "--seeds", 2, "--out", tmp_path / "b"]
    printed = document("benchmark", "--suite", "digits", "--plan", *limits)
    assert [one["seed"] for one in printed["missing"]] == [0, 1]
    assert sum(one["runs"] for one in printed["estimates"]) == 2


@pytest.mark.long
def test_a_first_file(tmp_path):
    file = tmp_path / "pole.toml"
    printed = document("init", "CartPole-v1", "--steps", 1, "--out", file)
    assert printed["text"] == file.read_text()


def test_an_error_stays_a_sentence_and_stdout_empty():
    result = CliRunner().invoke(app, ["envs", "nothing", "--json"])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Error: Expected" in result.stderr


@pytest.mark.long
def test_what_others_print_goes_to_stderr(tmp_path):
    (tmp_path / "noisy.py").write_text(NOISY)
    done = subprocess.run(
        [sys.executable, "-m", "sada_gym", "check", str(tmp_path / "noisy.py"), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1  # its parameter is dead
    assert "a word\n" in done.stderr
    assert "a word of a library in C" in done.stderr
    (report,) = json.loads(done.stdout)
    assert not report["passed"]
    assert {one["name"] for one in report["checks"] if not one["passed"]} == {"live parameters"}
