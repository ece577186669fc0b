"""Every path that a command takes: an empty one, or one that no system takes, is a sentence."""

from __future__ import annotations

import inspect

import pytest
from typer.testing import CliRunner

from sada_gym import attack
from sada_gym.analyses.regression.export import export
from sada_gym.cli import _COMMANDS, app
from sada_gym.errors import UserError
from sada_gym.foundations.lazy import load

SMALL = ["--budget", "5", "--samples", "3", "--workers", "1"]
LINES = {
    "attack": ["SADA-Analytic-v0", "-a", "random", *SMALL],
    "benchmark": ["--track", "SADA-Analytic-v0", "-a", "random", "--images", "0", *SMALL],
    "confirm": ["run", "--env-kwargs", "digit=3", "--out", "new.json"],
    "diagnose": ["run"],
    "estimate": ["SADA-Analytic-v0", "--budget", "20", "--density", 'x0={"normal": [0, 1]}'],
    "export": ["run", "--out", "suite", "--confirm", "0"],
    "fetch": ["efficientnet-lite0"],
    "init": ["CartPole-v1", "--agent", "builtins:abs"],
    "regress": ["suite", "--agent", "cnn"],
    "replay": ["run", "--out", "new.gif"],
    "report": ["run", "run"],
    "submit": ["run", "--name", "mine", "--authors", "A", "--licence", "MIT"],
    "transfer": ["run"],
}
"""A line of each command that takes a path, the arguments that are paths first."""
ENDINGS = {("init", "file"): ".toml", ("replay", "out_file"): ".gif"}
TAKEN = [
    (command, name)
    for command, (function, *_) in _COMMANDS.items()
    for name, parameter in inspect.signature(load(f"sada_gym.cli.{function}")).parameters.items()
    if "Path" in str(parameter.annotation)
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make a folder with a run and its suite."""
    folder = tmp_path_factory.mktemp("made")
    small = {"budget": 30, "samples": 10, "workers": 1, "diagnose": False, "html": False}
    attack("SADA-Digits-3-v0", "random", **small, out=folder / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert CliRunner().invoke(app, ["export", *LINES["export"]]).exit_code == 0
    return folder


def files_in(folder):
    return {
        path
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (".lock", "thumbnails.zip")
    }


def line(command, name, path):
    """Return a command line in which that argument or option is `path`."""
    function = load(f"sada_gym.cli.{_COMMANDS[command][0]}")
    parameters = inspect.signature(function).parameters
    info, words = parameters[name].default, [*LINES[command]]
    if type(info).__name__ == "ArgumentInfo":
        place = [n for n, p in parameters.items() if isinstance(p.default, type(info))].index(name)
        words[place] = path
        return [command, *words]
    flags = info.param_decls or [f"--{name.replace('_', '-')}"]
    return [command, *words, flags[0], path]


# no command line holds a NUL
@pytest.mark.parametrize("path", ["", "x" * 300], ids=["empty", "long"])
@pytest.mark.parametrize(("command", "name"), TAKEN, ids=map("-".join, TAKEN))
def test_a_path_that_cannot_be_is_a_sentence(command, name, path, made, monkeypatch):
    monkeypatch.chdir(made)
    before = files_in(made)
    words = line(command, name, path + ENDINGS.get((command, name), "") if path else path)
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, SystemExit), result.exception
    last = result.stderr.strip().splitlines()[-1]
    assert (result.exit_code, "Expected " in last, last[:7]) == (2, True, "Error: "), result.output
    assert files_in(made) == before


def test_every_path_was_found():
    assert {("export", "out_file"), ("regress", "junit"), ("submit", "runs")} <= {*TAKEN}
    assert len(TAKEN) >= 22


@pytest.mark.parametrize("path", ["", "zero\0byte", 3])
def test_python_refuses_such_a_path_too(path, made):
    with pytest.raises(UserError, match=r"Expected the path of a suite|its name holds a NUL"):
        export([made / "run"], path)
    with pytest.raises(UserError, match=r"Expected the path of the folder for|holds a NUL"):
        attack("SADA-Analytic-v0", "random", budget=5, out=path)
