"""Random command lines and mutated TOML files, from a fixed seed: a result or a sentence.

A sample runs with the long tests; all 500 and 300 run by

    pytest tests/cli/test_random_commands.py -m slow
"""

from __future__ import annotations

import inspect
import os
import random
import re
import shutil
import signal
import sys

import pytest
from typer.testing import CliRunner

from sada_gym.cli import _COMMANDS, _load, app
from sada_gym.foundations.lazy import load

COMMANDS, FILES = 500, 300
SAMPLE = 15  # of which a part runs with the long tests
SECONDS = 300
"""A command that takes longer than this is a hang: each is tiny."""

TEXTS = ["", " ", "-", "--", "a", "x" * 300, "../..", "/", "~", "nan", "inf", "1e400", "-0"]
TEXTS += ["null", "[]", "{}", '{"a": 1}', "a=1", "=", "a=", "é☃", "\u202eabc", "a\nb", "\x1b[31m"]
TEXTS += [
    "\udcff",
    "%s",
    "true",
    "$HOME",
    "a:b",
    ":",
    "tcp://",
    "tcp://localhost:1",
    "0",
    "1",
    "-1",
]
NAMES = ["SADA-Analytic-v0", "SADA-Digits-3-v0", "SADA-Nothing-v0", "CartPole-v1", "analytic"]
NAMES += [
    "random",
    "level-set",
    "gaussian",
    "bbgan:paper",
    "quick",
    "paper",
    "digits",
    "cnn",
    "mine",
]
PLACES = ["run", "pole", "suite", "entries/mine", "empty", "pole.toml", "bytes", "push.py", "none"]
PLACES += [
    ".",
    "run/result.json",
    "pole.toml/x",
    "loop",
    "new/deep",
    "file.zip",
    "new.gif",
    "new.toml",
]
RIGHT = {"attack": ["SADA-Digits-3-v0", "pole.toml"], "init": ["CartPole-v1"]}
RIGHT |= {"envs": ["SADA-Digits-v0"], "regress": ["suite"], "submit": ["run", "entries/mine"]}
"""What comes first most of the time; of other commands that take something, a run."""
VALID = {
    "benchmark": [
        "--track SADA-Analytic-v0 -a random --seeds 1 --images 0 --budget 5 --samples 3",
        "--plan --suite digits",
    ],
    "check": ["pole.toml", "SADA-Analytic-v0", "push.py"],
    "confirm": ["pole --seeds 1", "run --env-kwargs digit=4 --samples 4 --workers 1"],
    "export": ["run --out new --confirm 0", "pole --out new.json --confirm 1"],
    "fetch": ["efficientnet-lite0 --file bytes", "--json"],
    "init": ["CartPole-v1 --agent push:act"],
    "regress": ["suite --agent push:act", "suite --agent push:act --baseline push:act"],
    "replay": ["run --out new.gif --seconds 1", "pole --out new.gif --seconds 1 --sample 2"],
    "transfer": [
        "run --to SADA-Digits-5-v0 --samples 4",
        "run --to SADA-Digits-3-v0 --seed 7 --out new.json",
    ],
}
"""Lines that end with a result; some of these commands' lines are such a line and options more."""
NUMBERS = ["0", "1", "2", "3", "-1", "1.5", "nan", "99999999999999999999", "1e3", "x", ""]
TAKES_A_RUN = {"diagnose", "report", "replay", "transfer", "confirm", "export"}
COSTLY = {"budget": "20", "samples": "6", "workers": "1", "steps": "1", "seeds": "1", "images": "0"}
COSTLY |= {"confirm": "1", "seeds": "1", "worlds": "2", "fps": "5", "episodes": "1", "count": "1"}
"""Options that decide what a command costs, and the values that stand there most of the time."""

FIXED = {
    "attack": ["--budget", "12", "--samples", "4", "--workers", "1", "--no-report"],
    "benchmark": ["--plan"],
    "fetch": ["--file", "bytes"],
    "init": ["--agent", "push:act"],
}
"""What every line of a command has, unless it names another value, so that it ends soon."""

TOML = """
environment = "CartPole-v1"
agent = "push:act"
agent_id = "push"
score = ["length", 500]
fooling_threshold = 0.5
max_steps = 12
episodes = 1
feasible = "gravity + length < 30"
on_error = "invalid"

[parameters]
gravity = [5.0, 20.0]
length = { kind = "attribute", low = 0.25, high = 1.0, unit = "m" }
force_mag = { kind = "attribute", choices = [5.0, 10.0] }
noise = { kind = "observation-noise", low = 0.0, high = 0.1 }
delay = { kind = "action-delay", low = 0, high = 2, integer = true }
"""
VALUES = ["nan", "inf", "-1", "0", "1", "1e300", "1e-320", "true", '""', "[]", "{}", "[[1]]", '"x"']
VALUES += ["9223372036854775807", "[1.0, 1.0]", "[2, 1]", "[nan, 1]", "[0, inf]", "1979-05-27"]
VALUES += [
    '"\\u202e"',
    '"a\\nb"',
    '"\U0001f600"',
    '["a", "a"]',
    "[1, true]",
    '"gravity <"',
    '"own"',
]
VALUES += ['"push:act"', '["return", 0, 1]', '"success"', '["success", "a.b"]', '"os:getcwd"']
VALUES += [
    "-9223372036854775808",
    "18446744073709551616",
    '"' + "y" * 300 + '"',
    '["false"]',
    "0.5",
]
KEYS = ["environment", "gravity", "low", "high", "choices", "kind", "nominal", "log", '"a b"', '""']
KEYS += ["privileged", "valid", "reuse", "num_envs", "env_kwargs", "timeout", "unit", "paths"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make a folder with a run, a run of a file, a suite, an entry, and what is none of these."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (folder / "pole.toml").write_text(TOML)
        (folder / "push.py").write_text("def act(observation):\n    return 1\n")
        (folder / "bytes").write_bytes(bytes(range(256)))
        (folder / "empty").mkdir()
        os.symlink("loop", folder / "loop")
        for command in (
            "attack SADA-Digits-3-v0 -a random --budget 30 --workers 1 --no-diagnose --out run",
            "attack pole.toml -a random --budget 20 --samples 8 --workers 1 --out pole",
            "export pole --out suite --confirm 1",
            "submit run --name mine --authors A --licence MIT --out entries",
        ):
            result = CliRunner().invoke(app, command.split())
            assert result.exit_code == 0, result.output
    return folder


@pytest.fixture
def workplace(made, tmp_path, monkeypatch):
    """A copy of that folder, in which a command runs; the next one begins with a fresh one."""

    path = [place for place in sys.path if place != str(made)]

    def fresh(number):
        folder = tmp_path / str(number)
        shutil.copytree(made, folder, symlinks=True)
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "path", [*path])  # each folder has a module `push` of its own
        monkeypatch.delitem(sys.modules, "push", raising=False)
        return folder

    return fresh


def random_line(number):
    """Return the words of a random command line."""
    rng = random.Random(f"line {number}")
    name = rng.choice([*_COMMANDS, *VALID, "attack", "attack"])
    parameters = [p for p in _load(name).params if not p.is_eager]
    options = [p for p in parameters if p.param_type_name == "option"]
    if name in VALID and rng.random() < 0.6:
        words = [name, *rng.choice(VALID[name]).split()]
        for option in rng.sample(options, min(len(options), rng.randint(0, 3))):
            words += words_of(option, name, rng)
        return words
    words, fixed = [name], [*FIXED.get(name, ())]
    for parameter in parameters:
        if parameter in options:
            if rng.random() > 0.25:
                continue
            words += words_of(parameter, name, rng)
            flag = max(parameter.opts, key=len)
            if flag in fixed:
                place = fixed.index(flag)
                del fixed[place : place + (1 if parameter.is_flag else 2)]
        elif rng.random() < 0.7 and name in TAKES_A_RUN | {*RIGHT}:
            words.append(rng.choice(RIGHT.get(name, ["run", "pole"])))
        elif rng.random() < 0.9:
            words.append(value_of(parameter, name, rng))
    if rng.random() < 0.1:
        words.insert(rng.randint(0, len(words)), rng.choice(TEXTS))
    return words + fixed


def words_of(option, name, rng):
    flag = max(option.opts, key=len)
    return [flag] if option.is_flag else [flag, value_of(option, name, rng)]


def value_of(parameter, name, rng):
    function = load(f"sada_gym.cli.{_COMMANDS[name][0]}")
    kind = str(inspect.signature(function).parameters[parameter.name].annotation)
    is_costly = parameter.name in COSTLY
    if is_costly and rng.random() < 0.7:
        return COSTLY[parameter.name]
    if is_costly or "int" in kind or "float" in kind:
        return rng.choice(NUMBERS)
    if "executor" in str(parameter.name):
        return rng.choice(["processes", "nonsense", "tcp://"])
    pools = (TEXTS, NAMES, PLACES, PLACES) if rng.random() < 0.5 else (NAMES, PLACES)
    return rng.choice(rng.choice(pools))


def mutated(number):
    """Return the bytes of a TOML file with one to three mutations."""
    rng = random.Random(f"file {number}")
    lines = TOML.strip().splitlines()
    for _ in range(rng.randint(1, 3)):
        place = rng.choice([i for i, line in enumerate(lines) if "=" in line])
        kind, line = rng.randint(0, 6), lines[place]
        if kind <= 1:
            lines[place] = f"{line.partition('=')[0]}= {rng.choice(VALUES)}"
        elif kind == 2:
            lines[place] = f"{rng.choice(KEYS)} ={line.partition('=')[2]}"
        elif kind == 3:
            del lines[place]
        elif kind == 4:
            lines.insert(place, f"{rng.choice(KEYS)} = {rng.choice(VALUES)}")
        elif kind == 5:  # a value within a table
            found = [*re.finditer(r"(?<== )[^,{}=]+(?=[,}])", line)] or [
                *re.finditer(r"\d+\.\d", line)
            ]
            if found:
                match = rng.choice(found)
                lines[place] = line[: match.start()] + rng.choice(VALUES) + line[match.end() :]
        else:
            other = rng.choice([i for i, line in enumerate(lines) if "=" in line])
            lines[place], lines[other] = (
                line.partition("=")[0] + "=" + lines[other].partition("=")[2],
                lines[other].partition("=")[0] + "=" + line.partition("=")[2],
            )
    content = "\n".join(lines).encode()
    if rng.random() < 0.1:
        place = rng.randrange(len(content))
        content = content[:place] + rng.randbytes(2) + content[place + rng.randint(0, 40) :]
    return content


def complaint(words):
    """Run a command; say what was no result and no sentence, or return None."""

    def too_long(number, frame):
        raise TimeoutError(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(SECONDS)
    try:
        result = CliRunner().invoke(app, words, env={"COLUMNS": "200"})
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    raised = result.exception
    if raised is not None and not isinstance(raised, SystemExit):
        return f"{words}: {raised!r}"
    if "Traceback" in result.output or result.exit_code not in (0, 1, 2, 3):
        return f"{words}: exit code {result.exit_code}\n{result.output[-2_000:]}"
    if result.exit_code and not result.stderr.strip():
        return f"{words}: exit code {result.exit_code} without a word\n{result.output[-500:]}"
    return None


def run_lines(numbers, workplace):
    complaints = []
    for number in numbers:
        folder = workplace(number)
        complaints.append(complaint(random_line(number)))
        shutil.rmtree(folder, ignore_errors=True)
    return [*filter(None, complaints)]


def run_files(numbers, workplace):
    complaints = []
    for number in numbers:
        folder = workplace(number)
        (folder / "mutated.toml").write_bytes(mutated(number))
        words = ["attack", "mutated.toml", "-a", "random", "--budget", "2", "--samples", "2"]
        found = complaint([*words, "--workers", "1", "--no-report", "--out", "new"])
        complaints.append(found and f"file {number}: {found}")
        shutil.rmtree(folder, ignore_errors=True)
    return [*filter(None, complaints)]


@pytest.mark.long
def test_a_sample_of_random_command_lines_ends_in_a_result_or_a_sentence(workplace):
    assert run_lines(range(0, COMMANDS, SAMPLE), workplace) == []


@pytest.mark.long
def test_a_sample_of_mutated_files_ends_in_a_result_or_a_sentence(workplace):
    assert run_files(range(0, FILES, SAMPLE), workplace) == []


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_random_command_lines_end_in_a_result_or_a_sentence(part, workplace):
    assert run_lines(range(part, COMMANDS, 10), workplace) == []


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_mutated_files_end_in_a_result_or_a_sentence(part, workplace):
    assert run_files(range(part, FILES, 10), workplace) == []


def test_the_lines_and_files_are_the_same_everywhere():
    assert [random_line(7), mutated(7)] == [random_line(7), mutated(7)]
    assert len({str(random_line(n)) for n in range(COMMANDS)}) > 0.8 * COMMANDS
    assert len({mutated(n) for n in range(FILES)}) > 0.9 * FILES
