"""`sada-gym export` and `sada-gym regress`, with agents in files and a TOML file."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import torch
from stable_baselines3 import PPO
from torch import nn
from typer.testing import CliRunner

from sada_gym.cli import app

POLE = """
environment = "CartPole-v1"
agent = "the agent.pt"
score = ["return", 0.0, 100.0]
max_steps = 100
fooling_threshold = 0.6

[parameters]
length = [0.2, 3.0]
gravity = [5.0, 30.0]
"""


class Balance(nn.Module):
    """Pushes the cart to where the pole leans, and better by its angular velocity too."""

    def __init__(self, velocity: float) -> None:
        super().__init__()
        self.weights = nn.Parameter(torch.tensor([0.0, 0.0, 1.0, velocity]))

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return (state @ self.weights > 0).long()


def save(velocity: float, path: Path) -> Path:
    torch.jit.trace(Balance(velocity), torch.zeros(1, 4)).save(str(path))
    return path


def run(*args: str | Path):
    return CliRunner().invoke(app, [*map(str, args)], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pole gate")
    (folder / "pole.toml").write_text(POLE)
    for name, velocity in (("the agent", -0.02), ("better", 1.0), ("worse", -0.1)):
        save(velocity, folder / f"{name}.pt")
    words = "-a random --budget 0 --samples 80 --workers 1 --out"
    assert run("attack", folder / "pole.toml", *words.split(), folder / "run").exit_code == 0
    exported = run("export", folder / "run", "--out", folder / "suite", "--confirm", "2")
    assert exported.exit_code == 0, exported.output
    assert "worlds like them that pass" in exported.stdout
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("agent", "code", "words"),
    [
        ("the agent.pt", 0, "Passed. It is the same agent in the same application."),
        ("better.pt", 0, "Passed. None of"),
        ("worse.pt", 1, "Failed. "),
    ],
)
def test_exit_codes_of_files(folder, tmp_path, agent, code, words):
    junit, text = tmp_path / "junit.xml", tmp_path / "comment.md"
    command = ("regress", folder / "suite", "--agent", folder / agent)
    result = run(*command, "--junit", junit, "--markdown", text)
    assert result.exit_code == code, result.output
    assert words in result.stdout
    assert bool(ET.parse(junit).findall(".//failure")) == (code == 1)
    assert text.read_text().startswith("### CartPole")
    printed = run(*command, "--json", "--workers", "2" if code else "1")
    assert printed.exit_code == code
    assert json.loads(printed.stdout)["decision"]["status"] in ("passed", "failed")


def test_a_moved_suite_goes_on_without_the_run_and_with_a_newer_agent_file(folder, tmp_path):
    moved = tmp_path / "a b"
    shutil.copytree(folder / "suite", moved / "suite")
    result = run("regress", moved / "suite", "--agent", folder / "better.pt")
    assert result.exit_code == 0, result.output
    shutil.copy(folder / "worse.pt", moved / "the agent.pt")  # where the suite knows the agent
    command = ("regress", moved / "suite", "--agent", moved / "the agent.pt")
    result = run(*command, "--baseline", folder / "better.pt")
    assert result.exit_code == 1, result.output
    assert "the agent.pt is another file than when it was exported" in result.stdout
    assert "came back" in result.stdout


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["export", "{f}", "--out", "x"], "holds no attack.json"),
        (["regress", "{f}/none", "--agent", "a.pt"], "no such file or folder"),
        (["regress", "{f}/suite", "--agent", "{f}/none.pt"], "no such file"),
        (["regress", "{f}/suite", "--agent", "{f}/pole.toml"], "a zip file that SB3 wrote"),
        (["regress", "{f}/suite", "--agent", "{f}/wide.pt"], "got RuntimeError: mat1"),
        (["regress", "{f}/suite", "--agent", "{f}/better.pt", "--margin", "5"], "a margin above 0"),
    ],
)
def test_bad_input_is_one_sentence(folder, args, message):
    network = nn.Linear(7, 2)
    torch.jit.trace(network, torch.zeros(1, 7)).save(str(folder / "wide.pt"))
    result = run(*(word.format(f=folder) for word in args))
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert "Traceback" not in result.output


def test_a_track_takes_the_names_of_its_agents(tmp_path):
    words = "attack SADA-Analytic-v0 -a random --budget 0 --samples 60 --workers 1 --env-kwargs"
    assert run(*words.split(), "volume=0.3", "--out", tmp_path / "run").exit_code == 0
    suite = tmp_path / "suite.json"
    printed = run("export", tmp_path / "run", "--out", suite, "--json")
    assert printed.exit_code == 0, printed.output
    content = json.loads(suite.read_text())
    assert json.loads(printed.stdout) == content
    assert content["test_item"]["env_kwargs"] == {"volume": 0.3}


def jobs() -> dict[str, str]:
    """Return the shell lines of the page's jobs that call `regress`."""
    page = (Path(__file__).parents[2] / "docs" / "regression.md").read_text()
    github = re.search(r"^      - run: \|\n((?: {10}.*\n)+)", page, re.MULTILINE)
    gitlab = re.search(r"^    - (sada-gym regress .*)$", page, re.MULTILINE)
    return {"github": textwrap.dedent(github[1]), "gitlab": gitlab[1]}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize("server", ["github", "gitlab"])
def test_the_jobs_of_the_page_work_as_printed(folder, tmp_path, server):
    (tmp_path / "suites").mkdir()
    shutil.copytree(folder / "suite", tmp_path / "suites" / "pole")
    (tmp_path / "agents").mkdir()
    untrained = PPO("MlpPolicy", "CartPole-v1", seed=0, device="cpu", n_steps=64)
    with torch.no_grad():
        untrained.policy.action_net.bias[:] = torch.tensor([100.0, -100.0])  # always to the left
    untrained.save(tmp_path / "agents" / "new.zip")
    command = f'sada-gym() {{ "{sys.executable}" -W ignore -m sada_gym "$@"; }}\n{jobs()[server]}'
    summary = tmp_path / "summary.md"
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", command],
        cwd=tmp_path,
        env={**os.environ, "GITHUB_STEP_SUMMARY": str(summary)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Failed. " in done.stdout
    assert ET.parse(tmp_path / "regress.xml").findall(".//failure")
    assert (tmp_path / "regress.md").read_text().startswith("### CartPole")
    if server == "github":
        assert summary.read_text() == (tmp_path / "regress.md").read_text()
