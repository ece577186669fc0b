"""Environments in processes of their own: the bits of this one, and a sentence for each fault."""

from __future__ import annotations

import ast
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import gymnasium as gym
import numpy as np
import old_worlds
import pytest
from broken_servers import BEHAVIOURS, NO_MESSAGES, TIMEOUT_S, array, broken_server, raw, told
from gymnasium.wrappers import TimeLimit
from wrapped_toys import balance, cart_pole, worlds

import sada_gym
from sada_gym import GymnasiumApplication
from sada_gym.agents.remote.places import Address
from sada_gym.envs.wrapped import Attribute, Function, Keyword
from sada_gym.envs.wrapped.served import FILE, ServedEnvironment, server_of
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import ServerLost, UserError
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations import serve_environment as server_module
from sada_gym.foundations.serve_environment import MISSING, Channel, Opaque, decode, encode
from sada_gym.testing.purity import assert_pure

SUPPORT = Path(old_worlds.__file__).parent


def command(environment, *options, python="python"):
    return server_of([python, "serve_environment.py", environment, *options], SUPPORT)


class Here(gym.Env):
    """An environment of `old_worlds` in this process."""

    observation_space = gym.spaces.Box(-9.0, 9.0, (2,))
    action_space = gym.spaces.Discrete(3)

    def __init__(self, wind=0.0, size=0.1):
        self.drift = old_worlds.Drift(wind, size)

    def reset(self, *, seed=None, options=None):
        self.drift.seed(seed)
        return self.drift.reset(), {}

    def step(self, action):
        seen, reward, done, info = self.drift.step(action)
        cut = info.get("TimeLimit.truncated", False)
        return seen, reward, done and not cut, cut, info


def back(seen):
    return int(seen[0] < 0) * 2


def drifting(environment, **options):
    settings = {
        "agent": back,
        "parameters": {"wind": Keyword(0.0, 0.7), "size": Keyword(0.01, 0.5)},
        "score": ("return", -10.0, 30.0),
        "fooling_threshold": 0.7,
        "max_steps": 40,
        "agent_id": "back",
    }
    return GymnasiumApplication(environment, **{**settings, **options})


@contextmanager
def serving(environment, *options):
    """Start a server, and give its address and its process."""
    program = subprocess.Popen(
        [sys.executable, str(FILE), environment, "--port", "0", *options],
        stderr=subprocess.PIPE,
        text=True,
        cwd=SUPPORT,
        # a shell in the background lets its programs ignore it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        line = program.stderr.readline()
        assert line.startswith("Serving at tcp://"), line + program.stderr.read()
        yield line.split()[-1], program
    finally:
        program.kill()
        program.communicate()


def test_the_server_is_one_file_for_python_3_8_and_numpy_alone():
    tree = ast.parse(FILE.read_text(encoding="utf-8"), feature_version=(3, 8))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {a.name if isinstance(n, ast.Import) else n.module for n in imports for a in n.names}
    assert {name.partition(".")[0] for name in names} - {*sys.stdlib_module_names} == {"numpy"}


def test_a_served_environment_scores_as_one_in_this_process():
    settings = {"derived": {"polemass_length": "masspole * length"}, "max_steps": 60}
    settings["score"] = ("return", 0.0, 60.0)
    here = cart_pole(**settings)
    with closing(cart_pole(command("CartPole-v1"), **settings)) as there:
        one, other = (app.evaluate(*worlds(app)) for app in (here, there))
        assert (one.score == other.score).all()
        assert one.infos == other.infos
        assert (there.name, there.version, there.render_fps) == ("CartPole", 1, 50)
        assert np.array_equal(there.nominal, here.nominal)
        assert there.stale == here.stale == {}
        mu, seeds = worlds(there)
        assert np.array_equal(there.render(mu[0], seeds[0]), here.render(mu[0], seeds[0]))
        assert_pure(there, n=3, sizes=(1, 2), other_process=False)
        assert there.fingerprint


def test_a_python_with_numpy_alone_serves_the_interface_of_gym_0_21(bare_python):
    here = drifting(lambda wind=0.0, size=0.1: TimeLimit(Here(wind, size), 40))
    with closing(drifting(command("old_worlds:old", python=bare_python))) as there:
        one, other = (app.evaluate(*worlds(app)) for app in (here, there))
        assert len({*one.score}) > 2
        assert (one.score == other.score).all()
        assert one.infos == other.infos
        assert there.render_fps == 20
        assert there.render(np.zeros(2), 1).shape == (8, 8, 3)
        seen = there.behaviours(*worlds(there))[0].data
        assert 0.0 < seen["info gust"] < 1.0


def test_a_python_with_numpy_alone_serves_the_interface_of_dm_control(bare_python):
    application = GymnasiumApplication(
        command("old_worlds:Control", python=bare_python),
        agent=lambda seen: -seen["place"] - (seen["time"] > 9),
        parameters={"mass": Attribute(0.2, 3.0, paths="body.model.mass[1]")},
        score=("return", -20.0, 20.0),
        fooling_threshold=0.5,
        max_steps=20,
        agent_id="push",
    )
    with closing(application):
        assert isinstance(application.episode_spec.observation_space, gym.spaces.Dict)
        found = application.evaluate([[-1.0], [1.0], [1.0]], [3, 3, 4])
        assert len({*found.score}) == 3
        assert [info["length"] for info in found.infos][1:] == [20.0, 20.0]
        assert_pure(application, n=3, sizes=(1, 2), other_process=False)


def test_attributes_are_read_and_set_in_the_other_process():
    made = ServedEnvironment(command("old_worlds:old"), 20.0)
    with closing(made):
        env, other = made(wind=0.5).unwrapped, made().unwrapped
        assert (env.wind, env.size, other.wind) == (0.5, 0.1, 0.0)
        env.wind = 0.25
        env.write_steps(("gains", (0,)), 7.0)
        env.write_steps(("mass", (slice(None),)), 4.0)
        assert (env.wind, env.gains, env.mass.tolist()) == (0.25, [7.0, 0.3], [4.0, 4.0])
        assert (other.gains, other.mass.tolist()) == ([0.2, 0.3], [1.0, 2.0])
        with pytest.raises(ValueError, match="read-only"):
            env.mass[0] = 1.0
        assert {"wind", "mass", "double"} <= {*env.numbers} <= {*dir(env)}
        assert env.read_steps(("nothing",)) is env.read_steps(("__class__",)) is MISSING
        assert isinstance(env.rng, Opaque)
        with pytest.raises(UserError, match="Expected numbers, texts, arrays"):
            env.config = {"rng": [env.rng]}
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            env.nothing  # noqa: B018


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"win": (0.0, 1.0)}, r"no 'win'. Did you mean wind\? Keywords: wind, size."),
        (
            {"seed": (0.0, 1.0)},
            "for 'seed', got <function in another process>",
        ),
        ({"m": Attribute(0.0, 1.0, paths="mass")}, r"Name one entry, such as 'mass\[0\]'"),
    ],
)
def test_parameters_that_are_not_there_get_the_usual_sentence(parameters, message):
    with pytest.raises(UserError, match=message):
        drifting(command("old_worlds:old"), parameters=parameters)


def test_an_attribute_that_the_constructor_computed_is_found():
    parameters = {"wind": Attribute(0.1, 0.5)}
    with pytest.warns(UserWarning, match="double was computed in the constructor"):
        drifting(command("old_worlds:old"), parameters=parameters).close()


def test_mujoco_computes_its_model_in_the_other_process():
    pytest.importorskip("mujoco")
    settings = {
        "agent": lambda seen: np.clip([8 * seen[1] + seen[3] + 0.3 * seen[0]], -3, 3),
        "parameters": {"mass": Attribute(0.2, 4.0, paths="model.body_mass[2]", factor=True)},
        "score": ("return", 0.0, 100.0),
        "fooling_threshold": 0.5,
        "max_steps": 100,
        "agent_id": "by hand",
    }
    here = GymnasiumApplication("InvertedPendulum-v5", **settings)
    with closing(GymnasiumApplication(command("InvertedPendulum-v5"), **settings)) as there:
        one, other = (app.evaluate([[-1.0], [1.0], [0.2]], [0, 1, 2]) for app in (here, there))
        assert (one.score == other.score).all()
        assert one.infos == other.infos


def test_what_an_environment_raises_is_told_as_here():
    ranges = {"wind": Keyword(0.0, 1.0)}
    with closing(drifting(command("old_worlds:old"), parameters=ranges)) as there:
        (info,) = there.evaluate([[1.0]], [0]).infos
    assert info["invalid"] == "a step raised ArithmeticError: blown away"


def test_a_reset_that_ignores_the_seed_gets_a_sentence():
    ranges = {"size": Attribute(0.01, 0.5)}
    with (
        closing(drifting(command("old_worlds:unseeded"), parameters=ranges)) as there,
        pytest.raises(UserError, match="unseeded"),
    ):
        there.evaluate(np.zeros((3, 1)), [0, 1, 2])


TOML = """environment = {environment}
agent = "wrapped_toys:balance"
agent_id = "by hand"
score = ["length", 50]
max_steps = 50
fooling_threshold = 0.5
[parameters]
gravity = [5.0, 20.0]
"""


def test_a_file_names_a_command_or_an_address(tmp_path):
    file = tmp_path / "pole.toml"
    file.write_text(TOML.format(environment='["python", "serve_environment.py", "CartPole-v1"]'))
    with closing(read_application(file)) as application, serving("CartPole-v1") as (address, _):
        file.write_text(TOML.format(environment=json.dumps(address)))
        with closing(read_application(file)) as other:
            assert other.settings == application.settings
            assert other.settings["environment"] == "served:CartPole-v1"
            assert other.settings["served"]["packages"]["gymnasium"] == gym.__version__
            mu, seeds = worlds(other)
            assert (application.evaluate(mu, seeds).score == other.evaluate(mu, seeds).score).all()


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ("tcp://nowhere", "such as 'tcp://127.0.0.1:7788' as the environment"),
        ([], "Expected a command as the environment"),
        (["no-such-program", "x"], "no program 'no-such-program' on the path"),
        (["python", "-c", "raise SystemExit('nothing')"], "with status 1 .* at last: nothing"),
        (["python", "-c", "import time; time.sleep(9)"], "did not connect .* within 1 s"),
        (
            ["python", "serve_environment.py", "Pole-v9"],
            "neither gymnasium nor gym knows 'Pole-v9'",
        ),
        (["python", "serve_environment.py", "nowhere:pole"], "No module named 'nowhere'"),
        (
            ["python", "serve_environment.py", "math:sqrt"],
            "sqrt to be made with .* TypeError",
        ),
        (f"tcp://127.0.0.1:{9}", "nothing answers there .* python serve_environment.py ID"),
    ],
)
def test_servers_that_do_not_start_get_a_sentence(environment, message):
    timeout = 1.0 if "sleep" in str(environment) else 30.0
    with pytest.raises(UserError, match=message) as caught:
        drifting(environment, agent_timeout=timeout)
    assert str(caught.value).isprintable()


def test_a_python_without_numpy_gets_a_sentence(bare_python, tmp_path):
    for found in Path(bare_python).parents[1].rglob("site-packages/numpy"):
        found.unlink()
    expected = r"status 1 .*Expected NumPy in .*, found none. Install it there: .* -m pip install"
    with pytest.raises(UserError, match=expected):
        drifting([bare_python, str(FILE), "old_worlds:old"])


def test_the_command_line_says_what_is_wrong():
    for arguments, message in (
        (["Pole-v9"], "Expected an environment that .* got 'Pole-v9'"),
        (["CartPole-v1", "--port", "70000"], "Expected to listen on 127.0.0.1:70000"),
    ):
        ran = subprocess.run(
            [sys.executable, str(FILE), *arguments], capture_output=True, text=True, check=False
        )
        assert ran.returncode == 2
        assert "Traceback" not in ran.stderr
        assert __import__("re").search(message, ran.stderr)


def ended(process):
    return Path(f"/proc/{process}/stat").read_text().split()[2] == "Z"


def test_each_connection_has_a_process_that_ends_with_it_and_with_the_server():
    with serving("old_worlds:slow", "--keyword", "size=0.2") as (address, program):
        made = [ServedEnvironment(server_of(address), 20.0) for _ in range(2)]
        children = Path(f"/proc/{program.pid}/task/{program.pid}/children")
        assert made[0]().unwrapped.size == 0.2
        assert len(children.read_text().split()) == 2
        made[0].close()
        until = time.monotonic() + 9.0
        while not ended(children.read_text().split()[0]):
            assert time.monotonic() < until
            time.sleep(0.05)
        (last,) = children.read_text().split()[1:]
        program.send_signal(signal.SIGINT)
        assert program.wait(9.0) == 0
        with pytest.raises(ServerLost, match=r"the process died, or closed it\. Fix or restart"):
            made[1]()
        until = time.monotonic() + 9.0
        while Path(f"/proc/{last}").exists() and not ended(last):
            assert time.monotonic() < until
            time.sleep(0.05)


def test_a_step_that_hangs_ends_soon_after_its_attack(monkeypatch):
    monkeypatch.setattr(server_module, "_GRACE_S", 0.2)
    ours, theirs = socket.socketpair()
    child = os.fork()
    if not child:
        os.setsid()
        ours.close()
        server_module._end_with(theirs, os.getppid())
    theirs.close()
    ours.close()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


def test_queries_go_on_after_the_server_has_died(tmp_path):
    mu, store = np.random.default_rng(0).uniform(-1, 1, (12, 2)), str(tmp_path / "store.sqlite")
    with closing(drifting(command("old_worlds:old"))) as application:
        whole = application.evaluate(mu, range(12)).score
        with serving("old_worlds:old") as (address, program):
            oracle = Oracle(drifting(address), budget=12, seed=0, store=store)
            first = oracle(mu[:4])
            (child,) = Path(f"/proc/{program.pid}/task/{program.pid}/children").read_text().split()
            os.kill(int(child), signal.SIGKILL)
            with closing(oracle), pytest.raises(ServerLost, match="continue the run with --resume"):
                oracle(mu[4:])
        with closing(Oracle(application, budget=12, seed=0, store=store)) as resumed:
            again = resumed(mu)
    assert np.array_equal(again[:4], first)
    assert len({*whole}) > 4


def test_the_source_of_an_environment_is_part_of_its_identity(tmp_path):
    (tmp_path / "old_worlds.py").write_text(Path(old_worlds.__file__).read_text() + "\nx = 1\n")
    keys = []
    for folder in (SUPPORT, tmp_path):
        there = server_of(["python", "serve_environment.py", "old_worlds:old"], folder)
        with closing(drifting(there)) as application:
            keys.append(application.settings)
    assert keys[0].pop("served") != keys[1].pop("served")
    assert keys[0] == keys[1]


HELLO = {
    "type": "hello",
    "number": 1,
    "protocol": 2,
    "name": "Drift",
    "digest": "0" * 64,
    "packages": {"drift": "1.0"},
    "python": "3.8.18",
    "any_keyword": False,
    "keywords": {"dict": [["wind", 0.0]]},
    "own": {"dict": []},
}
BOX = {"kind": "Box", "shape": [2], "dtype": "F32", "low": -9.0, "high": 9.0}
CHOICE = {"kind": "Discrete", "shape": [], "dtype": "I64", "low": 0, "high": 2}
SPACES = {"observation_space": BOX, "action_space": CHOICE}
MADE = {"modes": [], "fps": None, "limit": 9, "masks": False, "bytes": 0}
MAKE = {
    "type": "told",
    "number": 2,
    "value": {"dict": [[key, value] for key, value in MADE.items()]},
    "spaces": SPACES,
}
BEGUN = {
    "type": "told",
    "number": 3,
    "value": {"tuple": [{"array": "a"}, {"dict": []}]},
    "spaces": None,
}
SEEN = np.zeros(2, np.float32)


def stepped(observation, reward=1.0, number=4):
    parts = [observation, reward, False, False, {"dict": []}]
    return {"type": "told", "number": number, "value": {"tuple": parts}}


HELLOS = {
    "protocol 3": {**HELLO, "protocol": 3},
    "no protocol": {"type": "hello", "number": 1},
    "an agent's": {"type": "hello", "number": 1, "protocol": 2, "rows": 0},
    "a name of two lines": {**HELLO, "name": "a\nb"},
    "a name of 10,000 letters": {**HELLO, "name": "a" * 10_000},
    "packages of a list": {**HELLO, "packages": []},
    "a package with escapes": {**HELLO, "packages": {"\x1b[2J": "1"}},
    "keywords that are no value": {**HELLO, "keywords": {"array": "none"}},
    "keywords of a list": {**HELLO, "keywords": [1]},
    "a keyword of two words": {**HELLO, "keywords": {"dict": [["two words", 1]]}},
    "deep keywords": {**HELLO, "keywords": json.loads("[" * 99 + "]" * 99)},
    "an unknown key": {**HELLO, "admin": True},
    "another number": {**HELLO, "number": 2},
    "an error": {"type": "error", "number": 0, "message": "\x1b[2J\n" * 300},
}
MAKES = {
    "no value": {**MAKE, "value": None},
    "no limit": {**MAKE, "value": {"dict": []}},
    "a limit of a text": {**MAKE, "value": {"dict": [["limit", "x"]]}},
    "no spaces": {**MAKE, "spaces": None},
    "a space of text": {**MAKE, "spaces": {**SPACES, "action_space": {**CHOICE, "kind": "Text"}}},
    "10**10 numbers": {
        **MAKE,
        "spaces": {**SPACES, "observation_space": {**BOX, "shape": [10**10]}},
    },
    "bounds that cross": {**MAKE, "spaces": {**SPACES, "observation_space": {**BOX, "low": 10.0}}},
    "what raised": {"type": "raised", "number": 2, "kind": "E\n", "message": "x"},
    "an error": {"type": "error", "number": 0, "message": "no more"},
}
RESETS = {
    "no observation": told({**BEGUN, "value": {"tuple": []}}),
    "a list": told({**BEGUN, "value": [1, 2]}),
    "an array that is missing": told(BEGUN),
    "another number": told({**BEGUN, "number": 2}, a=SEEN),
    "an observation of another shape": told(BEGUN, a=np.zeros(3, np.float32)),
    "a huge shape": raw({"a": array("F32", [0, 2**45])}, text=json.dumps(BEGUN).encode()),
}


def check_one_sentence(place):
    began = time.monotonic()
    with pytest.raises((UserError, ServerLost)) as caught:
        drifting(place, agent_timeout=TIMEOUT_S, parameters={"wind": (0.0, 0.5)}, max_steps=9)
    message = str(caught.value)
    assert message.startswith("Expected ")
    assert message.isprintable()
    assert len(message) < 900
    assert time.monotonic() - began < TIMEOUT_S + 15.0


@pytest.mark.parametrize("answer", NO_MESSAGES.values(), ids=NO_MESSAGES)
def test_a_server_that_sends_no_message_gets_a_sentence(answer):
    check_one_sentence(broken_server(answer))
    check_one_sentence(broken_server(told(HELLO), told(MAKE), answer))


@pytest.mark.parametrize("answer", HELLOS.values(), ids=HELLOS)
def test_a_greeting_that_is_none_gets_a_sentence(answer):
    check_one_sentence(broken_server(told(answer)))


@pytest.mark.parametrize("answer", MAKES.values(), ids=MAKES)
def test_an_environment_that_is_none_gets_a_sentence(answer):
    check_one_sentence(broken_server(told(HELLO), told(answer)))


@pytest.mark.parametrize("answer", RESETS.values(), ids=RESETS)
def test_an_episode_that_is_none_gets_a_sentence(answer):
    check_one_sentence(broken_server(told(HELLO), told(MAKE), answer))


@pytest.mark.parametrize("act", BEHAVIOURS.values(), ids=BEHAVIOURS)
def test_a_server_that_behaves_badly_gets_a_sentence_in_time(act):
    check_one_sentence(broken_server(act))
    check_one_sentence(broken_server(told(HELLO), told(MAKE), act))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (told(stepped({"array": "a"}), a=np.full(2, np.nan, np.float32)), "holds NaN"),
        (told(stepped({"array": "a"}, {"float": "nan"}), a=SEEN), "a reward is nan"),
        (told({"type": "raised", "number": 4, "kind": "E", "message": "x"}), "a step raised E: x"),
    ],
)
def test_answers_that_no_simulator_should_give_break_the_world(answer, message):
    made = ServedEnvironment(broken_server(told(HELLO), told(MAKE), told(BEGUN, a=SEEN), answer), 2)
    from sada_gym.envs.wrapped.episodes import EpisodeSpec, EpisodeStart, RunningEpisode
    from sada_gym.envs.wrapped.factory import EnvFactory
    from sada_gym.envs.wrapped.scores import Length

    space = gym.spaces.Box(-9.0, 9.0, (2,)), gym.spaces.Discrete(3)
    spec = EpisodeSpec(EnvFactory(made, {}, 9), {}, *space, Length(9), "the agent")
    episode = RunningEpisode(spec, EpisodeStart({}, 0, 0), pictures=False)
    episode.step(np.int64(1))
    assert message in episode.broken


def test_spaces_that_change_in_a_reset_get_a_sentence():
    other = {**SPACES, "observation_space": {**BOX, "shape": [3]}}
    begun = told({**BEGUN, "spaces": other}, a=np.zeros(3, np.float32))
    made = ServedEnvironment(broken_server(told(HELLO), told(MAKE), begun), 2.0)
    env = made()
    env.reset(seed=0)
    assert env.unwrapped.observation_space.shape == (3,)


def answered(*messages):
    """Send messages to a server of an environment in this process, and return what it answers."""
    ours, theirs = socket.socketpair()
    session = server_module._Session(old_worlds.old, {})
    thread = threading.Thread(target=server_module._answer, args=(theirs, session))
    thread.start()
    answers = []
    with ours, suppress(OSError):
        for message in messages:
            ours.sendall(message)
        ours.shutdown(socket.SHUT_WR)
        channel = Channel(ours, 9.0)
        while (answer := channel.take(channel.deadline())) is not None:
            answers.append(json.loads(answer[0]))
    thread.join(9.0)
    assert not thread.is_alive()
    return answers


ASK = {"type": "hello", "number": 1, "to": "environment", "protocol": 2}
WANTED = {"dict": [["keywords", {"dict": []}], ["render", False], ["limit", None]]}
NEW = {"type": "make", "number": 2, "env": 1, "value": WANTED}
QUESTIONS = {
    "no hello": [NEW],
    "protocol 3": [{**ASK, "protocol": 3}],
    "an agent's hello": [{"type": "hello", "number": 1, "protocol": 2, "deterministic": True}],
    "a number below zero": [{**ASK, "number": -1}],
    "a type of a list": [{**ASK, "type": []}],
    "a type that is a method": [ASK, {**NEW, "type": "_spaces"}],
    "an unknown type": [ASK, {**NEW, "type": "quit"}],
    "an unknown environment": [ASK, {"type": "step", "number": 2, "env": 7, "value": 1}],
    "an environment twice": [ASK, NEW, NEW],
    "an environment of a text": [ASK, {**NEW, "env": "1"}],
    "a value that is none": [ASK, {**NEW, "value": {"eval": "1"}}],
    "an array that is missing": [ASK, {**NEW, "value": {"array": "x"}}],
    "a deep value": [ASK, {**NEW, "value": json.loads("[" * 99 + "]" * 99)}],
    "a list": [[1]],
}


@pytest.mark.parametrize("questions", QUESTIONS.values(), ids=QUESTIONS)
def test_a_question_that_is_none_is_refused_in_a_sentence(questions, capsys):
    last = answered(*map(told, questions))[-1]
    assert last["type"] == "error"
    assert last["message"].startswith("Expected questions of protocol 2 to an environment, got ")
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("message", NO_MESSAGES.values(), ids=NO_MESSAGES)
def test_a_client_that_sends_no_message_is_refused(message):
    for answer in answered(told(ASK), message)[1:]:
        assert answer["type"] == "error"
        assert len(json.dumps(answer)) < 1_000


@pytest.mark.parametrize(
    "question",
    [
        {"type": "make", "number": 2, "env": -1, "value": WANTED},
        {"type": "make", "number": 2, "env": 2**16, "value": WANTED},
        {"type": "make", "number": 2, "env": 1, "value": None},
        {"type": "make", "number": 2, "env": 1, "value": {"dict": [["keywords", 1]]}},
    ],
)
def test_what_a_server_cannot_do_is_told_and_its_connection_stays_open(question):
    again = {**NEW, "number": 3, "env": 5}
    _, raised, made = answered(told(ASK), told(question), told(again))
    assert raised["type"] == "raised"
    assert made["type"] == "told"


VALUES = [
    None,
    True,
    -(2**62),
    0.1,
    np.nextafter(0.1, 1.0).item(),
    5e-324,
    float("inf"),
    "a\ud800b",
    (1, (2.5, None)),
    [1, [2]],
    {"a": (1,), 3: {"b": [0.5]}},
    np.float64(0.3),
    np.float32(0.3),
    np.bool_(True),
    np.arange(6, dtype=">i2").reshape(2, 3)[:, ::2],
    np.zeros((0, 4)),
    np.array(2.0),
    slice(None, 3, None),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_values_cross_the_socket_unchanged(value):
    arrays = {}
    tree = json.loads(json.dumps(encode(value, arrays), allow_nan=False))
    back = decode(tree, arrays)
    expected = "a\\ud800b" if isinstance(value, str) else value
    assert type(back) is type(expected)
    assert np.array_equal(back, expected) if isinstance(value, np.ndarray) else back == expected


def test_other_values_are_named_and_never_run():
    arrays = {}
    tree = encode({"model": object(), "function": len, "texts": np.array(["a"])}, arrays)
    assert decode(tree, arrays)["model"].kind == "object"
    assert not arrays
    deep = []
    for _ in range(99):
        deep = [deep]
    assert "object" in json.dumps(encode(deep, {}))


def test_a_function_of_a_users_sets_attributes():
    ranges = {"wind": Function(0.0, 0.5, set=set_wind)}
    with closing(drifting(command("old_worlds:old"), parameters=ranges)) as there:
        length = there.evaluate([[-1.0], [1.0]], [1, 1]).infos
        assert length[0]["return"] == length[1]["return"]  # the wind blows across
        env, options = there.world([1.0], 1)
        env.reset(**options)
        assert env.unwrapped.wind == 0.5


def set_wind(env, value):
    env.wind = value


def test_serve_environment_serves_alone_the_attack_that_started_it(tmp_path):
    (tmp_path / "serve.py").write_text(
        f"import sys; sys.path.append({str(SUPPORT)!r})\n"
        "import old_worlds, sada_gym\n"
        "sada_gym.serve_environment(old_worlds.Drift, keywords={'size': 0.3})\n"
    )
    made = ServedEnvironment(server_of(["python", "serve.py"], tmp_path), 60.0)
    with closing(made):
        assert (made.__name__, made().unwrapped.size) == ("Drift", 0.3)
    assert sada_gym.serve_environment is server_module.serve_environment


def test_a_hostile_address_is_no_agent(tmp_path):
    with serving("CartPole-v1") as (address, _), pytest.raises(UserError, match="as environment="):
        cart_pole(agent=address, agent_id=None)
    assert balance(np.zeros(4)) == 0
    assert Address("127.0.0.1", 1).name == "127.0.0.1:1"
