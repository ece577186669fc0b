"""Every command that the package offers to its users runs as it is written."""

import html
import re
import shlex

import pytest
from typer.testing import CliRunner

from sada_gym.board.results.entry import METADATA_FILE
from sada_gym.cli import app
from sada_gym.foundations.files import read_toml

pytestmark = pytest.mark.long

TOML = """
environment = "CartPole-v1"
agent = "offered_agents:push_right"
agent_id = "push-right"
score = ["length", 500]
fooling_threshold = 0.5
max_steps = 20
[parameters]
gravity = [5.0, 20.0]
length = [0.25, 1.0]
"""
AGENT = "def push_right(observation):\n    return 1\n"


def run(command):
    """Run a command as a shell would; return its result."""
    program, *words = shlex.split(command)
    assert program == "sada-gym"
    result = CliRunner().invoke(app, words, env={"COLUMNS": "300"})
    assert result.exit_code == 0, result.output
    return result


def commands(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    found = re.findall(r'<div class="copy"><pre>(.*?)</pre>', text, re.DOTALL)
    return [html.unescape(command) for command in found]


def offered(folder):
    """Run what a report says to do next, where the run was made; return what repeats it."""
    *steps, again = commands(folder)
    for step in steps:
        run(step)
    return again


@pytest.mark.parametrize(
    "words",
    [
        "SADA-Analytic-v0 --adversary random --budget 20 --samples 10",
        "SADA-Analytic-v0 --adversary smc --set steps=5 --budget 40 --samples 10 --seed 3",
        "SADA-Digits-3-v0 --adversary random --budget 8 --samples 8 --agent cnn",
        "SADA-Digits-v0 --env-kwargs digit=4 --adversary gaussian --budget 20 --samples 8",
    ],
)
def test_the_command_of_a_report_repeats_its_run(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(f"sada-gym attack {words} --workers 1 --out 'my runs/first'")
    command = offered(tmp_path / "my runs" / "first")
    again = tmp_path / "first-again"
    run(f"{command} --workers 1")
    for name in ("worlds.csv", "diagnosis.json"):
        first = (tmp_path / "my runs" / "first" / name).read_bytes()
        assert (again / name).read_bytes() == first
    assert commands(again)[-1] == command.replace("first-again", "first-again-again")


def test_the_command_of_a_report_repeats_the_run_of_a_file(tmp_path, monkeypatch):
    folder = tmp_path / "my files"
    folder.mkdir()
    (folder / "pole.toml").write_text(TOML)
    (folder / "offered_agents.py").write_text(AGENT)
    monkeypatch.chdir(tmp_path)
    run("sada-gym attack 'my files/pole.toml' -a random --budget 4 --samples 4 --workers 1")
    (made,) = (tmp_path / "runs").iterdir()
    command = offered(made)
    assert shlex.split(command)[2] == "my files/pole.toml"
    run(f"{command} --workers 1")
    assert (tmp_path / f"{made.name}-again" / "result.json").is_file()


def test_an_entry_says_how_its_runs_were_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(
        "sada-gym attack SADA-Digits-3-v0 -a random --budget 20 --agent cnn --workers 1 "
        "--no-report --out first"
    )
    run("sada-gym submit first --name mine --authors 'Ada L.' --licence MIT --out entries")
    entry = next((tmp_path / "entries").rglob(METADATA_FILE))
    run(f"{read_toml(entry)['command']} --workers 1 --no-report --out again")
    first, again = ((tmp_path / name / "worlds.csv").read_bytes() for name in ("first", "again"))
    assert first == again
