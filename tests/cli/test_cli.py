import json
import os
import shlex
import signal
import subprocess
import sys
import time

import pytest
from interrupting import start_interruptible
from toy import Greedy
from typer.testing import CliRunner

from sada_gym import adversaries
from sada_gym.cli import app
from sada_gym.cli.console import key_values
from sada_gym.evaluation.store import EvaluationStore

ATTACK = ["attack", "SADA-Analytic-v0", "-a", "toy:Greedy", "--budget", "60", "--samples", "10"]


def run(*args):
    return CliRunner().invoke(app, [*map(str, args)], env={"COLUMNS": "200"})


def attack(out, *args):
    return run(*ATTACK, "--workers", 1, "--out", out, *args)


@pytest.mark.parametrize("command", ["envs", "agents", "adversaries"])
def test_lists(command):
    result = run(command)
    assert result.exit_code == 0
    named = {"envs": "SADA-Analytic-v0", "agents": "photographer", "adversaries": "random"}
    assert named[command] in result.stdout


def test_one_environment_in_detail():
    result = run("envs", "SADA-Analytic-v0", "--env-kwargs", "dimension=3")
    assert result.exit_code == 0
    assert "x2" in result.stdout
    assert "fooled where Q <= 0.3" in result.stdout


@pytest.mark.parametrize("command", [[], ["attack"], ["check"], ["envs"]])
def test_help(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert "Usage: " in result.stdout


def test_help_is_light():
    heavy = "('torch', 'scipy', 'matplotlib', 'pybullet', 'stable_baselines3', 'sklearn')"
    code = f"import sada_gym.cli, sys; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_attack_ends_with_its_figures(tmp_path):
    result = attack(tmp_path / "out")
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "result.json").read_text())
    assert f"{report['fooled']} of 10 samples" in result.stdout
    assert "of 60 queries fooled the agent" in result.stdout
    assert "marginals.png" in result.stdout


def test_attack_passes_everything_on(tmp_path):
    pairs = ["--env-kwargs", "dimension=3", "--env-kwargs", "volume=0.2", "--seed", "7"]
    assert attack(tmp_path / "out", *pairs).exit_code == 0
    settings = json.loads((tmp_path / "out" / "result.json").read_text())["settings"]
    assert settings["application_settings"]["dimension"] == 3
    assert settings["application_settings"]["volume"] == 0.2
    assert (settings["seed"], settings["budget"], settings["samples"]) == (7, 60, 10)
    assert settings["adversary"] == "toy:Greedy"


def test_a_second_run_needs_resume(tmp_path):
    assert attack(tmp_path / "out").exit_code == 0
    refused = attack(tmp_path / "out")
    assert refused.exit_code == 2
    assert "which holds a run. Resume that run with --resume" in refused.stderr
    resumed = attack(tmp_path / "out", "--resume")
    assert resumed.exit_code == 0
    other = attack(tmp_path / "out", "--resume", "--seed", "1")
    assert other.exit_code == 2
    assert "seed was 0 and is 1" in other.stderr


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["attack", "SADA-Analytc-v0"], "Did you mean 'SADA-Analytic-v0'"),
        ([*ATTACK[:2], "-a", "randon"], "random"),
        ([*ATTACK, "--set", "colour=3"], "colour"),
        ([*ATTACK, "--preset", "paper"], "Expected no preset with toy:Greedy"),
        ([*ATTACK, "-a", "bbgan", "--preset", "papr"], "papr"),
        ([*ATTACK, "--env-kwargs", "dimensions=3"], "Did you mean 'dimension'"),
        ([*ATTACK, "--env-kwargs", "dimension=0"], "Expected dimension to be an int of at least 1"),
        (
            [*ATTACK, "--env-kwargs", "dimension"],
            "Expected --env-kwargs key=value, got 'dimension'",
        ),
        (
            [*ATTACK, "--set", "a=1", "--set", "a=2"],
            "Expected each key of --set once, got 'a' twice",
        ),
        ([*ATTACK, "--set", "a=1", "b=2"], "got 'b=2' without one"),
        (["check", "mine.py", "--env-kwargs", "a=1", "b=2"], "--env-kwargs a=1 --env-kwargs b=2"),
        ([*ATTACK, "--agent", "x", "--env-kwargs", "agent=y"], "Expected the agent once"),
        ([*ATTACK, "--preset", "x", "--set", "preset=y"], "Expected the preset once"),
        ([*ATTACK, "--budget", "many"], "budget"),
        ([*ATTACK, "--samples", "0"], "samples"),
        (["envs", "SADA-Nothing-v0"], "Expected a registered environment id"),
        (["check", "SADA-Nothing-v0"], "Expected a registered environment id"),
        (["check", "nothing.py"], "Expected an existing Python file"),
        (["check", "mine.py", "--env-kwargs", "a=1"], "only with an environment's id"),
        (["frobnicate"], "frobnicate"),
    ],
)
def test_bad_input_gets_a_sentence(args, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_store_is_left_alone(tmp_path):
    attack(tmp_path / "out")
    store = tmp_path / "out" / "run.sqlite"
    store.write_bytes(b"mine" * 1000)
    result = attack(tmp_path / "out", "--resume")
    assert result.exit_code == 2
    assert "got something else in" in result.stderr
    assert store.read_bytes() == b"mine" * 1000


def test_debug_shows_the_traceback():
    with pytest.raises(ValueError, match="registered environment id"):
        CliRunner().invoke(app, ["--debug", "envs", "Nothing-v0"], catch_exceptions=False)


def test_a_bug_keeps_its_traceback(tmp_path, monkeypatch):
    class Buggy(Greedy):
        def train(self, oracle):
            raise KeyError("bug")

    monkeypatch.setattr(adversaries, "make", lambda *args, **options: Buggy(2))
    result = attack(tmp_path / "out")
    assert isinstance(result.exception, KeyError)


def test_check_of_ours():
    result = run("check", "SADA-Analytic-v0")
    assert result.exit_code == 0, result.output
    assert "fails" not in result.stdout


def test_check_of_a_users_file(tmp_path):
    mine = tmp_path / "mine.py"
    mine.write_text(IMPURE)
    result = run("check", mine)
    assert result.exit_code == 1
    assert "Mine" in result.stdout
    assert "fails" in result.stdout


IMPURE = """
import numpy as np
from sada_gym import Application, Parameter, ParameterSpace, Scored

class Mine(Application):
    name = "Mine"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0.0, 1.0))

    def _evaluate(self, mu, seeds):
        return Scored(np.full(len(mu), 1 / len(mu)), [{}] * len(mu))
"""


def test_values_are_json_or_text():
    pairs = ["a=1", "b=0.5", "c=true", "d=null", "e=[1, 2]", "f=car", "g=x=y", 'h="1"', "i="]
    assert key_values(pairs, "--set") == {
        "a": 1, "b": 0.5, "c": True, "d": None, "e": [1, 2], "f": "car", "g": "x=y", "h": "1",
        "i": "",
    }  # fmt: skip


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="sends a signal as a terminal does")
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_the_evaluations_and_says_how_to_resume(tmp_path, workers):
    out, log = tmp_path / "an out", tmp_path / "log"
    command = ["attack", "toy:Toy-v0", "-a", "toy:Greedy", "--budget", "300", "--samples", "10"]
    command += ["--workers", str(workers), "--out", str(out), "--executor", "processes"]
    command += ["--env-kwargs", "pause_s=0.01", "--env-kwargs", f"log={log}"]
    process = start_interruptible(command)
    while process.poll() is None and (not log.exists() or log.read_text().count("\n") < 150):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in printed
    with EvaluationStore(out / "run.sqlite") as store:
        kept = len(store)
    assert kept >= 64
    assert f"Stopped. {kept} evaluations are kept in {out}/run.sqlite" in printed
    resume = printed.strip().splitlines()[-1].strip()
    assert shlex.split(resume) == ["sada-gym", *command, "--resume"]
    log.unlink()
    done = start_interruptible([*command, "--resume"])
    _, printed = done.communicate(timeout=60)
    assert done.returncode == 0, printed
    assert log.read_text().count("\n") == 310 - kept
