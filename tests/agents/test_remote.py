"""Agents in a process of their own: served by us, by thirty lines, and by servers that fail."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize
from wrapped_toys import Reach, approach, balance, cart_pole, pendulum, reach, worlds

import sada_gym
from sada_gym import attack
from sada_gym.agents.remote.messages import (
    ANSWERS,
    QUESTIONS,
    Act,
    Actions,
    Channel,
    Hello,
    Welcome,
)
from sada_gym.agents.remote.places import place_of
from sada_gym.agents.remote.spaces import describe
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import AgentLost, UserError
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations import serve_environment
from sada_gym.testing.purity import assert_pure

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "agent-without-package.md"
SUPPORT = ROOT / "tests" / "support"


TOML = """environment = "CartPole-v1"
agent = {agent}
agent_timeout = 60
score = ["length", 500]
fooling_threshold = 0.5
[parameters]
gravity = [5.0, 20.0]
"""


def thirty_lines():
    page = PAGE.read_text(encoding="utf-8")
    (program,) = [
        block for block in re.findall(r"```python\n(.*?)```", page, re.S) if "def receive" in block
    ]
    return program


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


def scores(application):
    return application.evaluate(*worlds(application)).score


@contextmanager
def served(agent, **options):
    """Serve an agent from a thread, and give its address."""
    port = free_port()
    threading.Thread(
        target=sada_gym.serve, args=(agent,), kwargs={"port": port, **options}, daemon=True
    ).start()
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.05)
    yield f"tcp://127.0.0.1:{port}"


def test_thirty_lines_serve_from_a_python_without_this_package(bare_python, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    code = [bare_python, "-c", "import sada_gym"]
    assert subprocess.run(code, cwd=tmp_path, capture_output=True, check=False).returncode
    program = tmp_path / "my serve.py"
    program.write_text(thirty_lines())
    assert len(thirty_lines().splitlines()) <= 31
    monkeypatch.chdir(tmp_path)
    application = cart_pole(agent=[bare_python, "my serve.py"], agent_id=None)
    with closing(application):
        assert (scores(application) == scores(cart_pole())).all()
        assert application.agent_name == "balancer-1"
        assert application.fingerprint
        assert_pure(application, n=3, sizes=(1, 2), other_process=False)


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="this system has no Unix sockets")
@pytest.mark.parametrize(
    ("before", "family"),
    [
        ("", "AF_UNIX"),
        ("os.environ['SADA_GYM_CONNECT_UNIX'] = '/nowhere'", "AF_INET"),
        ("del os.environ['SADA_GYM_CONNECT_UNIX']", "AF_INET"),
    ],
)
def test_a_unix_socket_is_used_where_it_can(before, family, tmp_path, monkeypatch):
    (tmp_path / "t").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    (tmp_path / "serve.py").write_text(
        f"import os, sada_gym\n{before}\nsada_gym.serve(lambda seen: 1, name='right')\n"
    )
    opened = place_of([sys.executable, "serve.py"], tmp_path).open(60.0)
    try:
        assert opened.channel._connection.family.name == family
    finally:
        opened.close()
    assert not any((tmp_path / "t").iterdir())


def test_a_started_program_connects_where_a_path_is_too_long_for_a_socket(tmp_path, monkeypatch):
    (tmp_path / ("long" * 40)).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / ("long" * 40)))
    (tmp_path / "serve.py").write_text(thirty_lines())
    application = cart_pole(agent=["python", str(tmp_path / "serve.py")], agent_id=None)
    with closing(application):
        assert (scores(application) == scores(cart_pole())).all()
    assert not any((tmp_path / ("long" * 40)).iterdir())


class Counts:
    """Balances, but every third time it does the other thing."""

    def __init__(self):
        self.times = 0

    def __call__(self, seen):
        self.times += 1
        return balance(seen) if self.times % 3 else 1 - balance(seen)


class Masked(Reach):
    def action_masks(self):
        return np.array([self.position[0] > 0.0, self.position[0] <= 0.0])


class FirstValid:
    def predict(self, observation, deterministic, action_masks=None):
        return action_masks.argmax(axis=1), None


def draws(seen):
    return int(np.random.random() > 0.5)  # noqa: NPY002


@pytest.mark.parametrize(
    ("make", "agent", "more"),
    [
        (cart_pole, balance, {}),
        (cart_pole, Counts, {}),
        (reach, approach, {}),
        (lambda **more: reach(Masked, **more), FirstValid(), {}),
        (cart_pole, draws, {"deterministic": False}),
        (pendulum, PPO("MlpPolicy", "Pendulum-v1", seed=0, device="cpu"), {}),
    ],
    ids=["a function", "a class", "a dictionary", "masks", "draws", "SB3"],
)
def test_a_served_agent_scores_as_it_does_in_this_process(make, agent, more):
    with served(agent, name="one") as address, closing(make(agent=address, **more)) as application:
        assert (scores(application) == scores(make(agent=agent, **more))).all()
        assert_pure(application, n=3, sizes=(1, 2), other_process=False)


def test_the_name_that_a_server_tells_identifies_the_agent(tmp_path):
    model = PPO("MlpPolicy", "CartPole-v1", seed=0, device="cpu")
    model.save(tmp_path / "agent.zip")
    with served(tmp_path / "agent.zip") as weights, served(balance) as nameless:
        by_weights = cart_pole(agent=weights, agent_id=None)
        assert by_weights.fingerprint
        assert by_weights.agent_name == weights.removeprefix("tcp://")
        unknown = cart_pole(agent=nameless, agent_id=None)
        with pytest.raises(ValueError, match="Pass agent_id='a name you change with the agent'"):
            attack(unknown, "random", budget=4, samples=4, out=tmp_path / "run")
        assert cart_pole(agent=nameless, agent_id="mine").agent_name == "mine"


def test_a_server_answers_several_connections_and_outlives_nonsense():
    with served(Counts, name="counts") as address:
        first, second = (cart_pole(agent=address) for _ in range(2))
        host, port = address.removeprefix("tcp://").split(":")
        with socket.create_connection((host, int(port))) as odd:
            odd.sendall(b"GET / HTTP/1.1\r\n\r\n")
            with suppress(ConnectionResetError):
                assert odd.recv(100) == b""
        assert (scores(first) == scores(second)).all()


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_attack_with_workers_has_the_same_bits(workers, tmp_path):
    file = tmp_path / "serve.py"
    file.write_text(thirty_lines())
    with served(balance, name="balancer-1") as address:
        for i, agent in enumerate((["python", str(file)], address)):
            application = cart_pole(agent=agent, agent_id="one")
            out = tmp_path / f"run{i}"
            attack(application, "random", budget=8, samples=4, seed=0, workers=workers, out=out)
            application.close()
    plain = cart_pole(agent_id="one")
    attack(plain, "random", budget=8, samples=4, seed=0, out=tmp_path / "plain")
    found = [np.load(tmp_path / name / "samples.npz") for name in ("plain", "run0", "run1")]
    assert all((found[0]["score"] == other["score"]).all() for other in found)


BREAKING = """
import pathlib, struct, sys, time
asked = 0
{program}
"""


def breaking(tmp_path, how, after):
    """Write a server that breaks at its `after`-th answer until the file `fixed` is there."""
    program = thirty_lines().replace(
        "            send(answer, actions",
        f"""            asked += 1
            if asked > {after} and not pathlib.Path({str(tmp_path / "fixed")!r}).exists():
                {how}
            send(answer, actions""",
    )
    file = tmp_path / "serve.py"
    file.write_text(BREAKING.format(program=program))
    return ["python", str(file)]


RAW = "os.write(connection.fileno(), {!r})"
FAULTS = {
    "dies": ("print('out of memory'); sys.exit(3)", "the process died.*out of memory"),
    "is killed": ("os.kill(os.getpid(), 9)", "the process died|reset"),
    "stalls": ("time.sleep(60)", "no answer within 3 s"),
    "answers half": (RAW.format(b"\0\0\0\x10{") + "; sys.exit()", "half a message"),
    "answers HTTP": (RAW.format(b"HTTP/1.1 400"), "a message of 1,213,486,160 bytes"),
    "answers no arrays": ("connection.send_bytes(b'{x')", "none of safetensors"),
    "answers no object": ("send([])", "a message with its object: Input should be"),
    "answers another shape": (
        "send(answer, actions=np.zeros((2, 7)))",
        r"shape \(16,\) was expected, shape \(2, 7\) came",
    ),
    "answers without actions": ("send(answer)", "was expected, none came"),
    "answers another question": ("send({**answer, 'number': 1})", "to another question"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_server_that_fails_gets_a_sentence(fault, tmp_path):
    how, message = FAULTS[fault]
    command = breaking(tmp_path, how, after=2)
    with (
        closing(cart_pole(agent=command, agent_timeout=3.0)) as application,
        pytest.raises(AgentLost, match=message) as caught,
    ):
        application.evaluate([[0.0, 0.0]], [0])
    assert "continue the run with --resume" in str(caught.value)


@pytest.mark.long
def test_a_run_resumes_where_a_server_died_to_the_same_bits(tmp_path):
    run = {"budget": 8, "samples": 4, "seed": 0, "resume": True}
    command = breaking(tmp_path, "sys.exit(3)", after=500)
    application = cart_pole(agent=command, agent_id=None)
    with closing(application), pytest.raises(AgentLost):
        attack(application, "random", out=tmp_path / "run", **run)
    (tmp_path / "fixed").touch()
    with closing(application):
        attack(application, "random", out=tmp_path / "run", **run)
        attack(application, "random", out=tmp_path / "whole", **run)
    files = [np.load(tmp_path / name / "samples.npz") for name in ("run", "whole")]
    assert (files[0]["score"] == files[1]["score"]).all()


def test_statistics_belong_to_the_server(tmp_path):
    vec = VecNormalize(make_vec_env("Pendulum-v1", 1, seed=0))
    vec.obs_rms.mean += 0.5
    vec.save(str(tmp_path / "statistics.pkl"))
    PPO("MlpPolicy", "Pendulum-v1", seed=0, device="cpu").save(tmp_path / "agent.zip")
    known = {"vec_normalize": tmp_path / "statistics.pkl", "allow_pickle": True}
    here = pendulum(agent=tmp_path / "agent.zip", **known)
    with served(tmp_path / "agent.zip", **known) as address:
        assert (scores(pendulum(agent=address)) == scores(here)).all()
        with pytest.raises(UserError, match=r"no vec_normalize .*Pass it to sada_gym.serve"):
            pendulum(agent=address, **known)


def test_an_error_of_the_agent_itself_is_told():
    def fails(seen):
        raise ZeroDivisionError("no way")

    with (
        served(fails) as address,
        pytest.raises(UserError, match=r"got an error: Expected an action .*ZeroDivisionError"),
    ):
        cart_pole(agent=address).evaluate([[0.0, 0.0]], [0])


@pytest.mark.parametrize("away_s", [-1.0, 10.0])  # every look, or none, says that others are busy
def test_messages_come_awake_and_asleep(away_s, monkeypatch):
    monkeypatch.setattr(serve_environment, "_AWAY_S", away_s)
    ours, theirs = (Channel(side, 9.0) for side in socket.socketpair())

    def answer():
        while (message := theirs.receive(QUESTIONS)) is not None:
            time.sleep(2e-3 * (message[0].number % 2))  # longer than anybody stays awake
            theirs.send(Actions(number=message[0].number), message[1], theirs.deadline())

    threading.Thread(target=answer, daemon=True).start()
    for number in range(20):
        question = Act(number=number, start=False, count=3)
        ours.send(question, {"state": np.full(3, number)}, ours.deadline())
        header, arrays = ours.receive(ANSWERS)
        assert header.number == number
        np.testing.assert_array_equal(arrays["state"], number)
    ours.close()


def welcome(listening, *names):
    """Answer one hello for each name, each on a connection of its own."""
    for name in names:
        channel = Channel(listening.accept()[0], 9.0)
        number = channel.receive(QUESTIONS)[0].number
        answer = Welcome(number=number, protocol=2, name=name, rows=0)
        channel.send(answer, {}, channel.deadline())


def test_another_agent_at_the_same_address_is_noticed():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        names = ("first", "second")
        threading.Thread(target=welcome, args=(listening, *names), daemon=True).start()
        application = cart_pole(agent=f"tcp://127.0.0.1:{listening.getsockname()[1]}")
        application.close()
        with pytest.raises(
            AgentLost, match="not the agent of the first connection, which was first"
        ):
            application.evaluate([[0.0, 0.0]], [0])


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        ("tcp://127.0.0.1", "an address such as 'tcp://127.0.0.1:7788'"),
        ("tcp://127.0.0.1:99999", "an address such as"),
        (["no-such-program", "x"], "there is no program 'no-such-program' on the path"),
        ([], "a list of texts such as"),
        (["python", 3], "a list of texts such as"),
        (["python", "-c", "print('I go'); exit(4)"], "ended with status 4 .*at last: I go"),
        (["python", "-c", "import time; time.sleep(9)"], "did not connect to SADA_GYM_CONNECT wi"),
    ],
)
def test_what_names_no_agent_gets_a_sentence(agent, message):
    with pytest.raises(UserError, match=message):
        cart_pole(agent=agent, agent_timeout=1.0)


def test_nobody_at_an_address_gets_a_sentence():
    with pytest.raises(UserError, match=r"nothing answers there .*Start the agent's server"):
        cart_pole(agent=f"tcp://127.0.0.1:{free_port()}")
    with pytest.raises(UserError, match=r"agent_timeout .* above 0 and of at most 1e6, got 0"):
        cart_pole(agent_timeout=0)


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="it kills processes as POSIX does")
def test_the_program_ends_with_its_parent_even_where_both_hang(tmp_path):
    started = tmp_path / "pids"
    (tmp_path / "serve.py").write_text(
        "import os, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(99)'])\n"
        f"open({str(started)!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}')\n"
        "time.sleep(99)\n"
    )
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import wrapped_toys\n"
            f"wrapped_toys.cart_pole(agent=['python', {str(tmp_path / 'serve.py')!r}])",
        ],
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{SUPPORT}"},
    )
    until = time.monotonic() + 60.0
    while not (started.exists() and started.read_text().count(" ") == 1):
        assert time.monotonic() < until
        time.sleep(0.05)
    pids = [int(pid) for pid in started.read_text().split()]
    assert all(alive(pid) for pid in pids)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < until
        time.sleep(0.05)


def alive(pid):
    """Whether a process runs, and is no zombie that nobody has waited for."""
    try:
        os.kill(pid, 0)
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except (ProcessLookupError, FileNotFoundError):
        return False


def test_a_toml_file_names_a_command_or_an_address(tmp_path, monkeypatch):
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "serve.py").write_text(thirty_lines())
    (folder / "pole.toml").write_text(TOML.format(agent='["python", "serve.py"]'))
    monkeypatch.chdir(tmp_path)
    with closing(read_application(folder / "pole.toml")) as application:
        assert application.agent_name == "balancer-1"
        assert application.evaluate([[0.0]], [0]).score.shape == (1,)
    with served(balance, name="there") as address:
        (folder / "pole.toml").write_text(TOML.format(agent=json.dumps(address)))
        assert read_application(folder / "pole.toml").agent_name == "there"
    for agent, message in (("[]", "a list of texts"), ("3", "a command as an array of texts")):
        (folder / "pole.toml").write_text(TOML.format(agent=agent))
        with pytest.raises(UserError, match=message):
            read_application(folder / "pole.toml")


@pytest.mark.parametrize(
    "space",
    [
        spaces.Box(-1.0, 1.0, (2, 3), np.float32),
        spaces.Box(np.float32([-np.inf, 0.1]), np.float32([0.3, np.inf])),
        spaces.Box(0, 255, (4, 4, 3), np.uint8),
        spaces.Box(-1.0, 1.0, (), np.float64),
        spaces.Box(-np.inf, np.inf, (2,), np.float16),
        spaces.Box(0.0, 1.0, (0, 3)),
        spaces.Box(-(2**63), 2**63 - 2, (2,), np.int64),
        spaces.Box(0, 1, (2,), np.bool_),
        spaces.Discrete(3, start=-1),
        spaces.Discrete(3, dtype=np.int32),
        spaces.MultiDiscrete([2, 3]),
        spaces.MultiDiscrete([[2, 3], [4, 5]], np.int8, start=[[0, -1], [2, 3]]),
        spaces.MultiBinary(5),
        spaces.MultiBinary((2, 2)),
        spaces.Dict({"a b": spaces.Discrete(2), "(alone)": spaces.Box(0.0, 1.0, (1,))}),
    ],
)
def test_spaces_survive_the_way(space):
    ours, theirs = (Channel(side, 9.0) for side in socket.socketpair())
    arrays = {}
    hello = Hello(
        number=1,
        protocol=2,
        environment="any",
        observation_space=describe(space, "observation_space", arrays),
        action_space=describe(spaces.Discrete(2), "action_space", arrays),
        wrapped_by=(),
        action_masks=False,
        deterministic=True,
    )
    ours.send(hello, arrays, ours.deadline())
    got, bounds = theirs.receive(QUESTIONS)
    assert got == hello
    assert got.observation_space.made(bounds) == space


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (spaces.Text(3), "kind: Input should be 'Box'"),
        (spaces.Tuple([spaces.Discrete(2)]), "kind: Input should be 'Box'"),
        (spaces.Graph(spaces.Discrete(2), None), "kind: Input should be 'Box'"),
        (spaces.Dict({"a": spaces.Dict({"b": spaces.Discrete(2)})}), "kind: Input should be 'Box'"),
        (spaces.Dict({"a\x1b": spaces.Discrete(2)}), "control characters"),
        (spaces.Box(0.0, 1.0, (2,), np.longdouble), "dtype: Input should be 'BOOL'"),
        (spaces.Box(0.0, 1.0, (1,) * 17), "at most 16 items"),
        (spaces.Box(0, 255, (2_400, 2_400, 3), np.uint8), "at most 16,777,216 bytes, got 17,280,"),
    ],
)
def test_spaces_that_cannot_be_sent_get_a_sentence(space, message):
    with pytest.raises(UserError, match=f"Expected spaces that can be sent .*{message}"):
        describe(space, "observation_space", {})


@pytest.mark.long
def test_workers_say_that_an_agent_is_gone(tmp_path):
    port = free_port()
    file = tmp_path / "pole.toml"
    file.write_text(TOML.format(agent=f'"tcp://127.0.0.1:{port}"'))
    with socket.create_server(("127.0.0.1", port)) as listening:
        threading.Thread(target=welcome, args=(listening, "one"), daemon=True).start()
        oracle = Oracle(str(file), budget=4, seed=0, workers=2)
    with (
        closing(oracle),
        pytest.raises(
            UserError, match=rf"an agent in tcp://127.0.0.1:{port}, but nothing answers there"
        ),
    ):
        oracle(np.zeros((4, 1), np.float32))


def test_a_program_of_python_is_the_one_that_runs_here():
    assert place_of(["python", "x.py"])._executable == sys.executable
    assert place_of("agent.zip") is None
