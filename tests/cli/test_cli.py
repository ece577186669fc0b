import contextlib
import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from interrupting import start_interruptible
from rich.console import Console
from spending import spent_after_samples
from toy import Greedy
from typer.testing import CliRunner

import sada_gym
from sada_gym import adversaries
from sada_gym.board.benchmark.suite import find_suite
from sada_gym.cli import app
from sada_gym.cli.console import (
    Terminated,
    errors_as_sentences,
    key_values,
    say,
    show_resume_hint,
)
from sada_gym.errors import BudgetExhausted, UserError, WorkerError
from sada_gym.evaluation import executors
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.experiment.names import default_note
from sada_gym.parameters import all_can_exist

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


HEAVY = ("torch", "scipy", "matplotlib", "pybullet", "stable_baselines3", "sklearn", "numba")


@pytest.mark.parametrize(
    ("command", "more"),
    [
        (
            ["--help"],
            ["pydantic", "rich.console", "sada_gym.cli.attack", "sada_gym.foundations.files"],
        ),
        (["atack"], ["rich.console", "sada_gym.cli.attack", "sada_gym.foundations.files"]),
        (["attack", "--help"], ["sada_gym.foundations.files", "sada_gym.evaluation.oracle"]),
        (
            ["attack", "SADA-Detecton-v0"],
            ["sada_gym.foundations.files", "sada_gym.evaluation.oracle"],
        ),
        (["attack", "SADA-Detection-v0", "-a", "bbgn"], ["sada_gym.foundations.files"]),
        (["attack", "SADA-Detection-v0", "--agent", "nofile.pt"], ["sada_gym.foundations.files"]),
        (["attack", "SADA-Detection-v0", "--set", "steps"], ["sada_gym.foundations.files"]),
    ],
)
def test_help_and_misspelt_names_are_light(command, more, tmp_path):
    code = """
import sys
from sada_gym.cli import app
try:
    app(sys.argv[2:], prog_name="sada-gym")
except SystemExit:
    print("loaded:", sorted(set(sys.argv[1].split()) & set(sys.modules)))
"""
    asked = " ".join([*HEAVY, *more])
    done = subprocess.run(
        [sys.executable, "-c", code, asked, *command],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "loaded: []"


def test_every_command_has_a_line_that_fits():
    listed = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).stdout
    assert "..." not in listed.partition("Commands:")[2]
    for name in ("envs", "agents", "adversaries", "attack", "check", "benchmark", "submit"):
        assert re.search(rf"^  {name} +[A-Z].*\.$", listed, re.MULTILINE)


def test_a_misspelt_command_gets_a_suggestion():
    result = run("atack")
    assert result.exit_code == 2
    assert "Did you mean 'attack'?" in result.stderr


def test_attack_ends_with_its_figures(tmp_path):
    result = attack(tmp_path / "out")
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "out" / "result.json").read_text())
    assert f"{10 * report['fooled']} % of worlds that toy:Greedy makes (" in result.stdout
    assert f"{tmp_path / 'out' / 'report.html'}" in result.stdout


def test_attack_passes_everything_on(tmp_path):
    pairs = ["--env-kwargs", "dimension=3", "--env-kwargs", "volume=0.2", "--seed", "7"]
    assert attack(tmp_path / "out", *pairs).exit_code == 0
    report = json.loads((tmp_path / "out" / "result.json").read_text())
    experiment = report["settings"]["experiment"]
    assert experiment["target"]["application"]["settings"]["dimension"] == 3
    assert experiment["target"]["application"]["settings"]["volume"] == 0.2
    assert experiment["seed"] == 7
    assert experiment["protocol"] == {"rule": "", "budget": 60, "samples": 10}
    assert experiment["adversary"]["name"] == "toy:Greedy"


def test_a_second_run_needs_resume(tmp_path):
    assert attack(tmp_path / "out").exit_code == 0
    refused = attack(tmp_path / "out")
    assert refused.exit_code == 2
    assert "which holds a run. Resume that run with --resume" in refused.stderr
    resumed = attack(tmp_path / "out", "--resume")
    assert resumed.exit_code == 0
    assert "out holds a finished run. It is shown, not repeated." in resumed.stderr
    assert "holds a finished run" not in refused.stderr
    assert "10 new ones)" in resumed.stdout
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
        ([*ATTACK, "--env-kwargs", "dimensions=3"], "Did you mean dimension?"),
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
        ([*ATTACK, "-a", "bbgan", "--budget", "0"], "a budget of at least 1 query"),
        ([*ATTACK, "-a", "level-set", "--budget", "3"], "Expected a budget of at least"),
        ([*ATTACK[:2], "-a", "ppo", "--budget", "5"], "Expected a budget of at least"),
        (["attack", "SADA-Digits-3-v0", "--agent", "n.pt"], "or a .safetensors file"),
        (["attack", "CartPole-v1", "--agent", "n.zip"], "sada-gym init CartPole-v1 --agent n.zip"),
        (["attack", "CartPole-v1", "--env-kwargs", "a=1"], "Expected the keyword of CartPole-v1"),
        (["estimate", "runs/nothing"], "If it is a path: no such file or folder is there."),
        (["estimate", "a", "--density", "a.csv", "--density", "b=1"], "Expected --density once"),
        (["envs", "SADA-Nothing-v0"], "Expected a registered environment id"),
        (["check", "SADA-Nothing-v0"], "Expected a registered environment id"),
        (["check", "nothing.py"], "Expected an existing Python file"),
        (["check", "nothing.toml"], "nothing.toml, but there is no such file"),
        (["envs", "nothing.toml"], "nothing.toml, but there is no such file"),
        (["attack", "nothing.toml"], "nothing.toml, but there is no such file"),
        (["benchmark", "--track", "nothing.toml"], "got the file nothing.toml"),
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


@pytest.mark.parametrize("kind", [KeyError, ValueError, TypeError, ImportError, OSError])
def test_a_bug_keeps_its_traceback(tmp_path, monkeypatch, kind):
    class Buggy(Greedy):
        def train(self, oracle):
            raise kind("bug")

    monkeypatch.setattr(adversaries, "make", lambda *args, **options: Buggy(2))
    result = attack(tmp_path / "out")
    assert type(result.exception) is kind


@pytest.mark.parametrize(
    ("error", "code"),
    [(UserError("so"), 2), (BudgetExhausted("so"), 2), (WorkerError("so"), 1)],
)
def test_what_is_raised_on_purpose_is_a_sentence(error, code, capsys):
    with pytest.raises(typer.Exit) as caught, errors_as_sentences():
        raise error
    assert caught.value.exit_code == code
    assert capsys.readouterr().err == "Error: so\n"


def test_version():
    result = run("--version")
    assert result.exit_code == 0
    assert result.stdout == f"sada-gym {sada_gym.__version__}\n"


@pytest.mark.long
def test_the_summary_names_the_interval_and_the_uniform_rate(tmp_path):
    result = attack(tmp_path / "svm", "-a", "svm")
    made = r"\d+ % of worlds that svm makes \(\d+ to \d+, 10 new ones\)"
    assert re.search(made, result.stdout)
    even = r"(\d+) % of all worlds in the ranges \(\d+ to \d+, {} worlds\)"
    assert re.search(even.format(60), result.stdout), "all of its queries are uniform"
    result = attack(tmp_path / "random", "-a", "random")
    assert re.search(even.format(10), result.stdout)
    assert "that random makes" not in result.stdout
    result = attack(tmp_path / "greedy")
    assert "unknown for all worlds in the ranges: --adversary random" in result.stdout
    result = attack(tmp_path / "level-set", "-a", "level-set")
    rate = re.search(even.format(24), result.stdout)
    report = json.loads((tmp_path / "level-set" / "result.json").read_text())
    assert int(rate[1]) == pytest.approx(100 * report["uniform"]["fooled"] / 24, abs=0.5)


@pytest.mark.parametrize("name", adversaries.names())
def test_uniform_queries_are_declared_truly(name):
    class EnoughError(Exception):
        pass

    class FirstOnly:
        remaining, threshold, permits = 200, 0.3, staticmethod(all_can_exist)

        def __call__(self, mu):
            self.first = np.array(mu)
            raise EnoughError

    oracle = FirstOnly()
    oracle.first = np.zeros((0, 2))
    with contextlib.suppress(EnoughError):
        adversaries.make(name, 2, seed=5).train(oracle)
    uniform = np.random.default_rng(5).uniform(-1.0, 1.0, (200, 2)).astype(np.float32)
    part = adversaries.make(name, 2, seed=5).uniform_part(200)
    assert adversaries.find(name).uniform_queries == (part == 200)
    if part:
        np.testing.assert_array_equal(oracle.first, uniform[:part])
    else:
        assert not np.array_equal(oracle.first, uniform)


def test_the_summary_tells_of_the_reference_set(tmp_path):
    command = ["attack", "SADA-Digits-3-v0", "-a", "random", "--budget", 20, "--samples", 10]
    result = run(*command, "--workers", 1, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "result.json").read_text())
    rate = 100 * report["settings"]["experiment"]["target"]["reference"]["uniform_rate"]
    assert f"{rate:.0f} % of all worlds in the ranges (" in result.stdout
    assert "20,000 worlds)" in result.stdout
    assert report["relative_coverage"] >= 0


@pytest.mark.parametrize(
    ("env_id", "pairs", "said"),
    [
        ("SADA-Detection-v0", [], "without object_class takes object_class=car, as SADA-Det"),
        ("SADA-Driving-v0", [], "without task takes task=navigation, as SADA-Driving-Navigation"),
        ("SADA-UAV-v0", [], "without anchors takes anchors=3, as SADA-UAV-3Anchors-v0 does."),
        ("sada_gym:SADA-UAV-v0", [], "without anchors takes anchors=3"),
        ("SADA-Detection-v0", ["object_class=bus"], None),
        ("SADA-Detection-Car-v0", [], None),
        ("SADA-Robot-v0", [], None),
        ("SADA-Digits-v0", [], None),
        ("CartPole-v1", [], None),
        ("mine.toml", [], None),
    ],
)
def test_a_general_id_says_what_it_takes(env_id, pairs, said):
    note = default_note(env_id, key_values(pairs, "--env-kwargs"))
    assert note is None if said is None else said in note


def test_the_summary_names_the_keywords_of_a_general_id(tmp_path):
    command = ["attack", "SADA-Digits-v0", "-a", "random", "--samples", 4, "--workers", 1]
    result = run(*command, "--env-kwargs", "digit=3", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "cnn in SADA-Digits-v0 (digit=3, as in SADA-Digits-3-v0)" in result.stdout


def test_the_result_is_all_that_stdout_gets(tmp_path):
    result = attack(tmp_path / "out")
    assert result.stdout.startswith("the agent in SADA-Analytic-v0, attacked by toy:Greedy\n")
    where = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["sentence"]
    assert f" where {where} " in " ".join(result.stdout.split())
    assert all(line == line.rstrip() for line in result.stdout.splitlines())


def test_an_executor_is_opened_by_its_name_and_closed(tmp_path, monkeypatch):
    asked, pools = [], []

    @contextlib.contextmanager
    def open_executor(name, workers):
        asked.append((name, workers))
        with ThreadPoolExecutor(3) as pool:
            pools.append(pool)
            yield SimpleNamespace(workers=executors.Workers(3, pool))

    monkeypatch.setattr(executors, "open_executor", open_executor)
    result = run(
        *ATTACK, "--workers", 2, "--executor", "dask:tcp://host:1", "--out", tmp_path / "a"
    )
    assert result.exit_code == 0, result.output
    assert asked == [("dask:tcp://host:1", 2)]
    assert pools[0]._shutdown
    attack(tmp_path / "b")
    same = [(tmp_path / name / "samples.npz").read_bytes() for name in "ab"]
    assert same[0] == same[1]


def test_uav_commands_print_no_line_of_pybullet():
    command = [sys.executable, "-c", "import sada_gym.envs.uav.world.physics"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""


PATH = "/somewhere/a-long-folder-name/that-does-not-fit-into-one-line/of-a-narrow-terminal/at-all"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_word_is_broken_or_cut_off(width):
    terminal = Console(force_terminal=True, width=width, file=io.StringIO(), no_color=True)
    sentence = f"Expected a file of weights in {PATH}, got a folder with something else inside."
    say(sentence, lead="Error: ", console=terminal)
    printed = terminal.file.getvalue()
    assert printed.split() == f"Error: {sentence}".split()
    assert all(len(line.rstrip()) <= width or PATH in line for line in printed.splitlines())


def test_in_a_pipe_a_sentence_is_one_line():
    pipe = Console(width=60, file=io.StringIO())
    say(f"{PATH} {PATH}", console=pipe)
    assert pipe.file.getvalue() == f"{PATH} {PATH}\n"


@pytest.mark.parametrize("width", ["60", "80", "120"])
def test_lists_keep_names_whole(width):
    environment = {"COLUMNS": width}
    listed = CliRunner().invoke(app, ["envs"], env=environment).stdout
    assert {"SADA-Detection-DiningTable-v0", "object_class=diningtable"} <= set(listed.split())
    listed = CliRunner().invoke(app, ["adversaries"], env=environment).stdout
    assert {"cross-entropy", "discriminator_updates=1"} <= set(listed.split())
    shown = CliRunner().invoke(app, ["attack", "--help"], env=environment).stdout
    assert {"--env-kwargs", "object_class=car;", "runs/ID-ADVERSARY-SEED"} <= set(
        re.split(r"[\s()\[\]]+", shown)
    )


def test_check_of_ours():
    result = run("check", "SADA-Analytic-v0")
    assert result.exit_code == 0, result.output
    assert "fails" not in result.stdout


@pytest.fixture
def pole(tmp_path, monkeypatch):
    """A TOML file about an agent in a module, one of whose parameters changes nothing."""
    (tmp_path / "leaning.py").write_text("def lean(seen):\n    return int(seen[2] > 0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "pole.toml").write_text(POLE)
    monkeypatch.chdir(tmp_path)
    return "pole.toml"


def test_an_attack_on_a_file(pole, tmp_path):
    command = ["attack", pole, "-a", "random", "--budget", 8, "--samples", 8, "--workers", 1]
    done = run(*command)
    assert done.exit_code == 0, done.output
    assert " in CartPole-v1, attacked by random" in done.stdout
    written = tmp_path / "runs" / "pole-random-0" / "result.json"
    first = written.read_bytes()
    assert json.loads(first)["settings"]["experiment"]["target"]["agent"] == "lean-1"
    assert run(*command).exit_code == 2
    assert run(*command, "--resume").exit_code == 0
    assert written.read_bytes() == first
    refused = run(*command, "--resume", "--agent", "x")
    assert refused.exit_code == 2
    assert "Write them into the file" in refused.stderr


def test_a_file_in_detail(pole):
    shown = run("envs", pole)
    assert shown.exit_code == 0, shown.output
    assert "screen_width" in shown.stdout
    assert "fooled where Q <= 0.5; 100 test samples" in shown.stdout


@pytest.mark.slow
def test_check_of_a_file_names_dead_parameters(pole):
    result = run("check", pole)
    assert result.exit_code == 1
    assert "screen_width" in re.sub(r"\W+", " ", result.stdout.partition("live parameters")[2])


POLE = """
environment = "CartPole-v1"
agent = "leaning:lean"
agent_id = "lean-1"
score = ["length", 20]
fooling_threshold = 0.5
max_steps = 20

[parameters]
gravity = [5, 40]
screen_width = { kind = "attribute", low = 300, high = 400, integer = true }
"""


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

    def evaluate_batch(self, mu, seeds):
        return Scored(np.full(len(mu), 1 / len(mu)), [{}] * len(mu))
"""


def test_values_are_json_or_text():
    pairs = ["a=1", "b=0.5", "c=true", "d=null", "e=[1, 2]", "f=car", "g=x=y", 'h="1"', "i="]
    assert key_values(pairs, "--set") == {
        "a": 1, "b": 0.5, "c": True, "d": None, "e": [1, 2], "f": "car", "g": "x=y", "h": "1",
        "i": "",
    }  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "ascii"])
def test_a_summary_can_be_written_in_any_encoding(tmp_path, encoding):
    code = (
        "import sys; from sada_gym.cli.terminal import prepare; prepare(); "
        "print('a\u2212b \u2013 \u2026 \u00d7 \u4e16', file=sys.stderr); "
        "sys.argv = ['sada-gym', *sys.argv[1:]]; from sada_gym.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *ATTACK, "--workers", "1", "--out", tmp_path / "out"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONIOENCODING": encoding},
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    assert "fails in" in done.stdout.decode(encoding)
    said = done.stderr.decode(encoding).splitlines()[0]
    expected = {
        "cp1252": "a-b \u2013 \u2026 \u00d7 ?",
        "latin-1": "a-b - ... \u00d7 ?",
        "ascii": "a-b - ... x ?",
    }
    assert said == expected[encoding]


@pytest.mark.long
def test_a_terminal_of_unknown_width_and_a_deleted_folder(tmp_path):
    command = [sys.executable, "-m", "sada_gym", "adversaries"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "0"}
    listed = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert listed.returncode == 0, listed.stderr
    assert "bbgan" in listed.stdout
    (tmp_path / "gone").mkdir()
    code = "import os, sys; from sada_gym.cli import main; sys.argv[1:] = ['adversaries']; "
    code += f"os.chdir({str(tmp_path / 'gone')!r}); os.rmdir(os.getcwd()); main()"
    refused = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert refused.returncode == 2
    assert refused.stderr.startswith(b"Error: Expected a working directory, got one that was del")


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="sends a signal as a terminal does")
@pytest.mark.parametrize(
    ("workers", "sent", "code"), [(1, "SIGINT", 130), (2, "SIGINT", 130), (2, "SIGTERM", 143)]
)
def test_a_stop_keeps_the_evaluations_and_says_how_to_resume(tmp_path, workers, sent, code):
    out, log = tmp_path / "an out", tmp_path / "log"
    command = ["attack", "toy:Toy-v0", "-a", "toy:Greedy", "--budget", "300", "--samples", "10"]
    command += ["--workers", str(workers), "--out", str(out), "--executor", "processes"]
    command += ["--env-kwargs", "pause_s=0.01", "--env-kwargs", f"log={log}"]
    process = start_interruptible(command)
    while process.poll() is None and (not log.exists() or log.read_text().count("\n") < 150):
        time.sleep(0.01)
    os.killpg(process.pid, getattr(signal, sent))
    _, printed = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in printed
    assert "semaphore" not in printed
    with EvaluationStore(out / "run.sqlite") as store:
        kept = len(store)
    assert kept >= 64
    assert f"Stopped. {kept} evaluations are saved in {out}/run.sqlite" in printed
    resume = printed.strip().splitlines()[-1].strip()
    assert shlex.split(resume) == ["sada-gym", *command, "--resume"]
    log.unlink()
    done = start_interruptible([*command, "--resume"])
    _, printed = done.communicate(timeout=60)
    assert done.returncode == 0, printed
    fresh, again = spent_after_samples(out)
    assert fresh >= 30  # of the diagnosis: fifteen inside a rule, and fifteen outside
    assert again > 0
    assert log.read_text().count("\n") == 310 + fresh + again - kept


@pytest.mark.parametrize("still_open", [False, True])
def test_a_stop_that_leaves_the_store_open_says_how_to_resume(tmp_path, monkeypatch, still_open):
    left = []

    def stopped(*_, out, **__):
        store = EvaluationStore(out / "run.sqlite")
        left.append(store)
        if not still_open:
            store.close()
        raise Terminated

    monkeypatch.setattr("sada_gym.attacks.attack", stopped)
    (tmp_path / "an out").mkdir()
    result = run("attack", "SADA-Analytic-v0", "--out", tmp_path / "an out")
    assert result.exit_code == 143
    if still_open:
        left[0].close()
        assert f"The evaluations are saved in {tmp_path / 'an out'}/run.sqlite" in result.output
        assert "--resume" in result.output
    else:
        assert "Nothing was saved" in result.output


def test_a_stopped_check_prints_what_it_found(monkeypatch):
    def stopped(env):
        raise KeyboardInterrupt

    monkeypatch.setattr("sada_gym.testing.check._check_gymnasium", stopped)
    result = run("check", "SADA-Analytic-v0")
    assert result.exit_code == 130
    assert "Stopped. What was found so far:" in result.stderr
    assert "purity" in result.stdout
    assert "check_env of Stable-Baselines3" not in result.stdout


@pytest.mark.parametrize(
    "given", [[], ["--suite", "quick"], ["--suite", "robot"]], ids=lambda given: " ".join(given)
)
def test_a_benchmarks_report_is_of_the_suite_that_is_named(given, monkeypatch, tmp_path):
    asked = []

    def report(folder, references, **chosen):
        asked.append(chosen)
        raise UserError("Expected finished runs.")

    monkeypatch.setattr("sada_gym.board.benchmark.run.report_benchmark", report)
    run("benchmark", "--report", "--out", tmp_path, *given)
    (chosen,) = asked
    named = chosen.get("suite")
    suite = find_suite(given[1]) if given else None
    assert (named and named.tracks) == (suite and suite.tracks)
    assert (named and named.tables) == (suite and suite.tables)


@pytest.mark.parametrize(
    ("called", "path", "told"),
    [
        ("bin/sada-gym", "bin", "sada-gym"),
        ("bin/sada-gym", "elsewhere", "bin/sada-gym"),
        ("sada_gym/__main__.py", "elsewhere", "sada-gym"),
    ],
)
def test_the_command_that_goes_on_is_found_where_it_was_called(
    called, path, told, tmp_path, monkeypatch, capsys
):
    """`make attack` calls the command of an environment that is not active."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "sada-gym").touch(0o755)
    monkeypatch.setenv("PATH", path)
    monkeypatch.setattr(sys, "argv", [called, "attack", "ID", "--out", "a b"])
    show_resume_hint("Some evaluations are kept.", "--resume")
    assert capsys.readouterr().err.splitlines()[-1] == f"  {told} attack ID --out 'a b' --resume"
