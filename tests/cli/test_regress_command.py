"""`sada-gym export` and `sada-gym regress`, with agents in files and a TOML file."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import torch
from junitparser import Failure, JUnitXml, Skipped
from stable_baselines3 import PPO
from torch import nn
from typer.testing import CliRunner

from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.regress import regress
from sada_gym.cli import app
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import Notice, UserError

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
    words = "-a random --budget 0 --samples 80 --workers 1 --no-report --out"
    assert run("attack", folder / "pole.toml", *words.split(), folder / "run").exit_code == 0
    exported = run("export", folder / "run", "--out", folder / "suite", "--confirm", "2")
    assert exported.exit_code == 0, exported.output
    assert "similar worlds that pass" in exported.stdout
    return folder


@pytest.fixture(scope="module")
def new_zip(tmp_path_factory) -> Path:
    """Return an SB3 agent that is worse: it always pushes to the left."""
    untrained = PPO("MlpPolicy", "CartPole-v1", seed=0, device="cpu", n_steps=64)
    with torch.no_grad():
        untrained.policy.action_net.bias[:] = torch.tensor([100.0, -100.0])
    path = tmp_path_factory.mktemp("agent") / "new.zip"
    untrained.save(path)
    return path


def read_junit(path: Path) -> tuple[int, int, int]:
    """Return the numbers of worlds, failures and skipped ones, which JUnit tells twice."""
    root = JUnitXml.fromfile(str(path))
    cases = [case for suite in root for case in suite]
    kinds = [type(result) for case in cases for result in case.result]
    counts = len(cases), kinds.count(Failure), kinds.count(Skipped)
    assert (root.tests, root.failures, root.skipped) == counts
    assert root.errors == 0
    return counts


AGENTS = [
    ("the agent.pt", 0, "passed", "Passed. It is the same agent in the same application."),
    ("better.pt", 0, "passed", "Passed. No regression"),
    ("worse.pt", 1, "failed", "Failed. "),
]


@pytest.mark.parametrize(("agent", "code", "status", "words"), AGENTS)
def test_exit_codes_of_files(folder, tmp_path, agent, code, status, words):
    junit, text = tmp_path / "junit.xml", tmp_path / "comment.md"
    command = ("regress", folder / "suite", "--agent", folder / agent)
    result = run(*command, "--junit", junit, "--markdown", text)
    assert result.exit_code == code, result.output
    assert words in result.stdout
    printed = run(*command, "--json")
    assert printed.exit_code == code
    content = json.loads(printed.stdout)
    assert content["decision"]["status"] == status
    changes = [world["change"] for world in content["worlds"]]
    broken = sum(changes.count(change) for change in ("regressed", "new failure"))
    assert read_junit(junit) == (len(changes), broken, changes.count("still fails"))
    assert bool(broken) == (code == 1)
    assert text.read_text().startswith("### CartPole")


def test_the_heading_names_the_agent_under_test_and_the_one_that_the_suite_is_of(folder, tmp_path):
    shutil.copy(folder / "the agent.pt", tmp_path)
    toml = tmp_path / "pole.toml"
    toml.write_text('agent_id = "the old one"\n' + POLE)
    words = "-a random --budget 0 --samples 80 --workers 1 --no-report --out"
    assert run("attack", toml, *words.split(), tmp_path / "run").exit_code == 0
    exported = run("export", tmp_path / "run", "--out", tmp_path / "suite", "--confirm", "1")
    assert exported.exit_code == 0, exported.output
    command = ("regress", tmp_path / "suite", "--agent")
    heading = run(*command, folder / "better.pt").stdout.splitlines()[0]
    assert re.match(
        r"better [0-9a-f]{12} on CartPole-v1, compared with what the suite expects \(made with the "
        r"old one\)$",
        heading,
    )
    same = run(*command, tmp_path / "the agent.pt").stdout
    assert same.startswith("the old one on CartPole-v1")
    assert "It is the same agent" in same


@pytest.mark.long
def test_a_suite_has_the_worlds_of_its_run_with_derived_attributes_and_a_module(
    tmp_path, monkeypatch
):
    derived = {"polemass_length": "masspole * length", "total_mass": "masspole + masscart"}
    (tmp_path / "leaning_agent.py").write_text("act = lambda seen: int(seen[2] > 0.02 * seen[3])\n")
    text = POLE.replace("the agent.pt", "leaning_agent:act").replace(
        "[parameters]", "[parameters]\nmasspole = [0.05, 1.0]"
    )
    table = "".join(f'{name} = "{text}"\n' for name, text in derived.items())
    (tmp_path / "pole.toml").write_text(f"agent_id = 'leaning'\n{text}\n[derived]\n{table}")
    words = "-a random --budget 0 --samples 40 --workers 1 --no-report --no-diagnose --out"

    def in_new_process(*words):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "path", [*sys.path])
            patch.delitem(sys.modules, "leaning_agent", raising=False)
            return run(*words)

    attacked = in_new_process("attack", tmp_path / "pole.toml", *words.split(), tmp_path / "run")
    assert attacked.exit_code == 0, attacked.output
    suite = ["--out", tmp_path / "suite", "--confirm", "1"]
    assert in_new_process("export", tmp_path / "run", *suite).exit_code == 0
    words = ["regress", tmp_path / "suite", "--agent", "leaning_agent:act", "--json"]
    told = json.loads(in_new_process(*words).stdout)
    assert told["decision"]["status"] == "passed"
    assert told["differences"] == []

    worlds = [(world["case"]["mu"], world["case"]["seeds"]) for world in told["worlds"]]
    mu, seeds = ([one for one, _ in worlds], [s for _, (s,) in worlds])
    scores = [score for world in told["worlds"] for score in world["scores"]]
    application = read_application(tmp_path / "pole.toml")
    assert application.stale == {}
    assert application.evaluate(mu, seeds).score.tolist() == scores
    assert [
        score for world in regress(tmp_path / "suite", application).worlds for score in world.scores
    ] == scores

    (tmp_path / "stale.toml").write_text(f"agent_id = 'leaning'\n{text}")
    with pytest.warns(Notice, match="polemass_length"):
        stale = read_application(tmp_path / "stale.toml")
    assert stale.evaluate(mu, seeds).score.tolist() != scores
    assert any("derived" in one for one in regress(tmp_path / "suite", stale).differences)
    with pytest.raises(UserError, match="derived"):
        export(tmp_path / "run", tmp_path / "other", application=stale)


def test_too_few_worlds_are_inconclusive(folder, tmp_path):
    content = json.loads((folder / "suite" / "suite.json").read_text())
    controls = [case for case in content["test_cases"] if case["objective"] == "control"]
    content["test_cases"], content["ordinary_cases"] = controls[:4], []
    (tmp_path / "suite.json").write_text(json.dumps(content))
    (tmp_path / "pole.toml").write_text(POLE)
    command = ("regress", tmp_path, "--agent", folder / "worse.pt", "--junit", tmp_path / "j.xml")
    result = run(*command)
    assert result.exit_code == 3, result.output
    assert "Inconclusive. " in result.stdout
    assert read_junit(tmp_path / "j.xml")[1] > 0


@pytest.mark.long
def test_the_exit_code_does_not_depend_on_workers(folder):
    command = ("regress", folder / "suite", "--agent", folder / "worse.pt", "--workers", "2")
    printed = run(*command, "--json")
    assert printed.exit_code == 1, printed.output
    assert json.loads(printed.stdout)["decision"]["status"] == "failed"


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
    assert "worlds fail that passed before" in result.stdout


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
    """Return the shell lines of the pages' jobs that call `regress`."""
    docs = Path(__file__).parents[2] / "docs"
    page = "".join((docs / name).read_text() for name in ("regression.md", "regression-ci.md"))
    github = re.search(r"^      - run: \|\n((?: {10}.*\n)+)", page, re.MULTILINE)
    gitlab = re.search(r"^    - (sada-gym regress .*)$", page, re.MULTILINE)
    return {"github": textwrap.dedent(github[1]), "gitlab": gitlab[1]}


NEEDS_BASH = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")


@pytest.fixture
def clone(folder, new_zip, tmp_path) -> Path:
    """Return a folder with the suite and the agent where the page's jobs look for them."""
    shutil.copytree(folder / "suite", tmp_path / "suites" / "pole")
    (tmp_path / "agents").mkdir()
    shutil.copy(new_zip, tmp_path / "agents")
    return tmp_path


def run_job(clone: Path, server: str, gate: str) -> subprocess.CompletedProcess[str]:
    """Run a job's lines as its server does, with this body of the function `sada-gym`."""
    return subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", f"sada-gym() {{ {gate}; }}\n{jobs()[server]}"],
        cwd=clone,
        env={**os.environ, "GITHUB_STEP_SUMMARY": str(clone / "summary.md")},
        capture_output=True,
        text=True,
        timeout=120,
    )


@NEEDS_BASH
@pytest.mark.parametrize("server", ["github", "gitlab"])
def test_the_words_of_the_jobs_test_the_agent(clone, monkeypatch, server):
    run_job(clone, server, r"""printf '%s\n' "$@" > words""")
    words = (clone / "words").read_text().splitlines()
    monkeypatch.chdir(clone)
    result = run(*words)
    assert result.exit_code == 1, result.output
    assert read_junit(clone / "regress.xml")[1] > 0
    assert (clone / "regress.md").read_text().startswith("### CartPole")


@NEEDS_BASH
@pytest.mark.parametrize(
    ("server", "code", "left"),
    [
        *[("github", code, code) for code in (0, 1, 2)],
        ("github", 3, 0),
        *[("gitlab", code, code) for code in (0, 1, 2, 3)],  # `allow_failure` takes the 3
    ],
)
def test_the_jobs_end_with_the_code_of_the_gate(tmp_path, server, code, left):
    wrote = code != 2
    gate = f"{'echo told > regress.md; ' if wrote else ''}return {code}"
    done = run_job(tmp_path, server, gate)
    assert done.returncode == left, done.stderr
    assert ("::warning::" in done.stdout) == (server == "github" and code == 3)
    summary = tmp_path / "summary.md"
    assert summary.exists() == (server == "github" and wrote)
    if summary.exists():
        assert summary.read_text() == "told\n"


@pytest.mark.long
@NEEDS_BASH
@pytest.mark.parametrize("server", ["github", "gitlab"])
def test_the_jobs_of_the_page_work_as_printed(clone, server):
    done = run_job(clone, server, f'"{sys.executable}" -W ignore -m sada_gym "$@"')
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Failed. " in done.stdout
    assert read_junit(clone / "regress.xml")[1] > 0
    assert (clone / "regress.md").read_text().startswith("### CartPole")
    if server == "github":
        assert (clone / "summary.md").read_text() == (clone / "regress.md").read_text()
