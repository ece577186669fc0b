"""Broken servers and hostile clients: one sentence in time, little memory, and others go on."""

from __future__ import annotations

import json
import resource
import socket
import struct
import threading
import time
from contextlib import closing, suppress

import numpy as np
import pytest
from broken_servers import (
    BEHAVIOURS,
    NO_MESSAGES,
    TIMEOUT_S,
    array,
    broken_server,
    raw,
    received,
    told,
    wait,
)
from gymnasium import spaces

import sada_gym
from sada_gym.agents.contract import Interface
from sada_gym.agents.remote import server as server_module
from sada_gym.agents.remote.client import RemoteAgent
from sada_gym.agents.remote.places import Address
from sada_gym.errors import AgentLost, UserError

MOST_MB = 300
POLE = Interface("any", spaces.Box(-1.0, 1.0, (4,)), spaces.Discrete(2))
THREE = np.arange(3)


WELCOME = {"type": "hello", "number": 1, "protocol": 2, "rows": 0}
WELCOMES = {
    "protocol 3": {**WELCOME, "protocol": 3},
    "no protocol": {"type": "hello", "number": 1},
    "rows below zero": {**WELCOME, "rows": -1},
    "rows of a text": {**WELCOME, "rows": "16"},
    "rows of 10**9": {**WELCOME, "rows": 10**9},
    "a name that is a number": {**WELCOME, "name": 3},
    "a name of two lines": {**WELCOME, "name": "a\nb"},
    "a name that writes backwards": {**WELCOME, "name": "a\u202eb"},
    "a name of 10,000 letters": {**WELCOME, "name": "a" * 10_000},
    "a fingerprint that is a list": {**WELCOME, "fingerprint": []},
    "masks that are a number": {**WELCOME, "action_masks": 1},
    "a key that is unknown": {**WELCOME, "row": 1},
    "another number": {**WELCOME, "number": 2},
    "actions": {"type": "actions", "number": 1},
    "an error that is no text": {"type": "error", "number": 1, "message": None},
    "an error with escapes": {"type": "error", "number": 1, "message": "\x1b[2J\n\u202e\0" * 200},
}
ACTIONS = {"type": "actions", "number": 2}
ANSWERS = {
    "another number": told({**ACTIONS, "number": 1}, actions=THREE),
    "a hello": told({**WELCOME, "number": 2}),
    "no actions": told(ACTIONS),
    "actions of another name": told(ACTIONS, action=THREE),
    "too few": told(ACTIONS, actions=THREE[:2]),
    "too many dimensions": told(ACTIONS, actions=THREE[:, None]),
    "one number": told(ACTIONS, actions=np.array(1)),
    "none at all": told(ACTIONS, actions=THREE[:0]),
    "an empty shape of 10**18": raw(
        {"actions": array("F32", [0, 10**18])}, text=json.dumps(ACTIONS).encode()
    ),
    "twice the same key": raw(
        b'{"message":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},'
        b'"message":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}',
        b"{}",
    ),
}


class Episodes:
    def observe(self, which):
        return {"(alone)": np.zeros((len(which), 4), np.float32)}

    def agent_seed(self, i):
        return i


def megabytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def asked(agent, acts):
    assert acts, "this agent should not have been connected"
    agent.start(3)
    return agent.act(Episodes(), THREE)


def check_one_sentence(place, *, acts):
    before, began = megabytes(), time.monotonic()
    with pytest.raises((UserError, AgentLost)) as caught:
        asked(RemoteAgent(place, POLE, timeout_s=TIMEOUT_S), acts)
    message = str(caught.value)
    assert message.startswith("Expected ")
    assert f"tcp://127.0.0.1:{place.port}" in message
    assert message.isprintable()
    assert len(message) < 700
    assert time.monotonic() - began < TIMEOUT_S + 2.0
    assert megabytes() - before < MOST_MB


@pytest.mark.parametrize("answer", NO_MESSAGES.values(), ids=NO_MESSAGES)
def test_a_server_that_sends_no_message_gets_a_sentence(answer):
    check_one_sentence(broken_server(answer), acts=False)
    check_one_sentence(broken_server(told(WELCOME), answer), acts=True)


@pytest.mark.parametrize("answer", WELCOMES.values(), ids=WELCOMES)
def test_a_welcome_that_is_none_gets_a_sentence(answer):
    check_one_sentence(broken_server(told(answer)), acts=False)


@pytest.mark.parametrize("answer", ANSWERS.values(), ids=ANSWERS)
def test_actions_that_are_none_get_a_sentence(answer):
    check_one_sentence(broken_server(told(WELCOME), answer), acts=True)


@pytest.mark.parametrize("act", BEHAVIOURS.values(), ids=BEHAVIOURS)
def test_a_server_that_behaves_badly_gets_a_sentence_in_time(act):
    check_one_sentence(broken_server(act), acts=False)
    check_one_sentence(broken_server(told(WELCOME), act), acts=True)


def test_a_server_that_does_not_read_gets_a_sentence_in_time():
    large = Interface("any", spaces.Box(-1.0, 1.0, (2**21,)), spaces.Discrete(2))
    place = broken_server(told(WELCOME), wait)

    class Many(Episodes):
        def observe(self, which):
            return {"(alone)": np.zeros((len(which), 2**21), np.float32)}

    agent = RemoteAgent(place, large, timeout_s=TIMEOUT_S)
    agent.start(3)
    with pytest.raises(AgentLost, match="no answer within"):
        agent.act(Many(), THREE)


BOX = {"kind": "Box", "shape": [4], "dtype": "F32", "low": -1.0, "high": 1.0}
CHOICE = {"kind": "Discrete", "shape": [], "dtype": "I64", "low": 0, "high": 1}
HELLO = {
    "type": "hello",
    "number": 1,
    "protocol": 2,
    "environment": "any",
    "observation_space": BOX,
    "action_space": CHOICE,
    "wrapped_by": [],
    "action_masks": False,
    "deterministic": True,
}


def seen_as(**changes):
    return told({**HELLO, "observation_space": {**BOX, **changes}})


def of_parts(parts):
    return told({**HELLO, "observation_space": {"kind": "Dict", "parts": parts}})


HELLOS = {
    "10**10 numbers": seen_as(shape=[10**10]),
    "200 million numbers": seen_as(shape=[2 * 10**8]),
    "10**30 numbers": seen_as(shape=[10**30]),
    "numbers that overflow": seen_as(shape=[2**32, 2**32]),
    "an empty shape of 10**30": seen_as(shape=[0, 10**30]),
    "70 dimensions": seen_as(shape=[1] * 70),
    "a shape below zero": seen_as(shape=[-1]),
    "a shape of fractions": seen_as(shape=[1.5]),
    "a shape of null": seen_as(shape=None),
    "a shape of lists": seen_as(shape=[[2]]),
    "a dtype of objects": seen_as(dtype="O"),
    "a dtype of 10,000 letters": seen_as(dtype="F" * 10_000),
    "bounds of text": seen_as(low="nowhere"),
    "bounds of lists": seen_as(low=[-1.0] * 4),
    "bounds that cross": seen_as(low=2.0),
    "bounds of 10**400": told(json.dumps(HELLO).replace("-1.0", "1" + "0" * 400)),
    "bounds of NaN": told(json.dumps(HELLO).replace("-1.0", "NaN")),
    "bounds of an array of NaN": told(
        {**HELLO, "observation_space": {**BOX, "low": "a"}}, a=np.full(4, np.nan, np.float32)
    ),
    "bounds of another shape": told(
        {**HELLO, "observation_space": {**BOX, "low": "a"}}, a=np.zeros((3, 3), np.float32)
    ),
    "no bounds": told({**HELLO, "observation_space": {"kind": "Box", "shape": [4]}}),
    "a space of null": told({**HELLO, "observation_space": None}),
    "a space of a text": told({**HELLO, "observation_space": "Box"}),
    "a space of text": seen_as(kind="Text"),
    "a graph": seen_as(kind="Graph"),
    "no choice": told({**HELLO, "action_space": {**CHOICE, "high": -1}}),
    "choices of infinity": told({**HELLO, "action_space": {**CHOICE, "high": None}}),
    "choices that overflow": told({**HELLO, "action_space": {**CHOICE, "high": 2**63 - 1}}),
    "choices of 10**30": told({**HELLO, "action_space": {**CHOICE, "high": 10**30}}),
    "2**40 choices with masks": told(
        {**HELLO, "action_masks": True, "action_space": {**CHOICE, "high": 2**40}}
    ),
    "bits of no shape": seen_as(kind="MultiBinary", shape=[]),
    "100 million choices": seen_as(kind="MultiDiscrete", dtype="I64", shape=[10**8], low=0),
    "a dictionary in a dictionary": of_parts({"a": {"kind": "Dict", "parts": {}}}),
    "100,000 parts": of_parts({str(i): CHOICE for i in range(5_000)}),
    "parts too large together": of_parts({str(i): {**BOX, "shape": [2**21]} for i in range(3)}),
    "a part with a null byte": of_parts({"a\0": BOX}),
    "wrapped by null": told({**HELLO, "wrapped_by": None}),
    "wrapped by a text": told({**HELLO, "wrapped_by": "ObservationWrapper"}),
    "wrapped by 10,000": told({**HELLO, "wrapped_by": ["x"] * 10_000}),
    "an environment of null": told({**HELLO, "environment": None}),
    "an environment with escapes": told({**HELLO, "environment": "\x1b[2J"}),
    "an environment of 10,000 letters": told({**HELLO, "environment": "x" * 10_000}),
    "masks of a text": told({**HELLO, "action_masks": "false"}),
    "protocol 3": told({**HELLO, "protocol": 3}),
    "no protocol": told({key: HELLO[key] for key in HELLO if key != "protocol"}),
    "an unknown key": told({**HELLO, "admin": True}),
    "actions at first": told({"type": "act", "number": 1, "start": True, "count": 3}),
}
ACT = {"type": "act", "number": 2, "start": True, "count": 3}
SEEN = np.zeros((3, 4), np.float32)
SENT = {"observation": SEEN, "episodes": THREE, "episode_seeds": THREE.astype(np.uint32)}


def changed(**arrays):
    return told(ACT, **{key: value for key, value in (SENT | arrays).items() if value is not None})


ACTS = {
    "no observation": changed(observation=None),
    "observations of float64": changed(observation=SEEN.astype(float)),
    "observations of another shape": changed(observation=np.zeros((3, 5), np.float32)),
    "fewer observations": changed(observation=SEEN[:2]),
    "one observation": changed(observation=np.zeros((), np.float32)),
    "no episodes": changed(episodes=None),
    "episodes of a number": changed(episodes=np.array(1)),
    "episodes of floats": changed(episodes=THREE.astype(float)),
    "episodes twice": changed(episodes=np.array([0, 1, 1])),
    "episodes below zero": changed(episodes=THREE - 1),
    "episodes beyond the count": changed(episodes=THREE + 1),
    "episodes of 2**62": changed(episodes=THREE + 2**62),
    "none": changed(observation=SEEN[:0], episodes=THREE[:0], episode_seeds=np.zeros(0, np.uint32)),
    "no seeds": changed(episode_seeds=None),
    "seeds of int64": changed(episode_seeds=THREE),
    "no start": told({**ACT, "start": False}, **SENT),
    "start of null": told({**ACT, "start": None}, **SENT),
    "a count of 10**9": told({**ACT, "count": 10**9}, **SENT),
    "a count below zero": told({**ACT, "count": -1}, **SENT),
    "a count of a text": told({**ACT, "count": "3"}, **SENT),
    "an answer": told({"type": "actions", "number": 2}, actions=THREE),
}


def right(seen):
    return int(seen[0] >= 0.0)


@pytest.fixture(scope="module")
def served():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    thread = threading.Thread(target=sada_gym.serve, args=(right,), kwargs={"port": port})
    thread.daemon = True
    thread.start()
    for _ in range(200):
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            break
        time.sleep(0.05)
    asked(RemoteAgent(Address("127.0.0.1", port), POLE, timeout_s=60.0), acts=True)  # loads torch
    return port


@pytest.fixture
def hostile(served):
    """A connection to a server; in the end others are answered at once, and memory stayed small."""
    before = megabytes()
    with socket.create_connection(("127.0.0.1", served)) as connection:
        connection.settimeout(9.0)
        yield connection
        with closing(RemoteAgent(Address("127.0.0.1", served), POLE, timeout_s=9.0)) as agent:
            assert asked(agent, acts=True).tolist() == [1, 1, 1]
    assert megabytes() - before < MOST_MB


def check_refused(connection):
    """Read an error in one sentence, or the end."""
    with suppress(OSError):  # it may be closed already
        connection.shutdown(socket.SHUT_WR)
        content = connection.recv(4, socket.MSG_WAITALL)
        if content:
            (length,) = struct.unpack(">I", content)
            answer = connection.recv(length, socket.MSG_WAITALL)
            assert b'"error"' in answer
            assert b"Expected" in answer
            assert b"Traceback" not in answer
            assert length < 1_000
        return content


@pytest.mark.parametrize("message", NO_MESSAGES.values(), ids=NO_MESSAGES)
def test_a_client_that_sends_no_message_is_closed(message, hostile):
    hostile.sendall(message)
    check_refused(hostile)


@pytest.mark.parametrize("message", HELLOS.values(), ids=HELLOS)
def test_a_hello_that_is_none_is_refused_in_a_sentence(message, hostile):
    hostile.sendall(message)
    assert check_refused(hostile)


@pytest.mark.parametrize("message", ACTS.values(), ids=ACTS)
def test_a_question_that_is_none_is_refused_in_a_sentence(message, hostile):
    hostile.sendall(told(HELLO))
    assert b'"error"' not in received(hostile)
    hostile.sendall(message)
    assert check_refused(hostile)


@pytest.mark.parametrize("begin", [b"", told(HELLO)[:-9], struct.pack(">I", 2**29)])
def test_a_client_that_stops_holds_nobody_up(begin, hostile):
    hostile.sendall(begin)


def test_a_client_that_says_hello_twice_is_answered(hostile):
    for _ in range(2):
        hostile.sendall(told(HELLO))
        assert b'"error"' not in received(hostile)
    hostile.sendall(told(ACT, **SENT))
    assert b'"actions"' in received(hostile)


def test_a_refused_hello_leaves_its_connection_open(hostile):
    hostile.sendall(HELLOS["bounds that cross"])
    assert b'"error"' in received(hostile)
    hostile.sendall(told(HELLO))
    assert b'"error"' not in received(hostile)


def test_a_client_of_the_first_protocol_is_told_in_its_own_format(hostile):
    hostile.sendall(NO_MESSAGES["protocol 1"])
    answer = json.loads(received(hostile))
    assert answer["type"] == "error"
    assert "Expected messages of protocol 2" in answer["message"]
    assert "Install the same version" in answer["message"]


def test_clients_that_are_slow_are_closed(served, monkeypatch, capsys):
    monkeypatch.setattr(server_module, "_PATIENCE_S", 0.2)
    for begin in (b"", b"\0\0\0\x99{"):
        with socket.create_connection(("127.0.0.1", served)) as connection:
            connection.sendall(begin)
            connection.settimeout(9.0)
            assert connection.recv(10) == b""
    assert "Traceback" not in capsys.readouterr().err


def test_connections_beyond_the_limit_are_closed_and_make_room_again(monkeypatch):
    monkeypatch.setattr(server_module, "_THREADS", threading.active_count() + 1)
    agent = server_module._Served(right, None, allow_pickle=False, normalisation=None)
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def connected():
            connection = socket.create_connection(listening.getsockname())
            agent.accept(listening)
            return connection

        first, _, third = connected(), connected(), connected()
        assert third.recv(10) == b""
        first.close()
        until = time.monotonic() + 9.0
        while True:
            with connected() as fourth, suppress(ConnectionError):
                fourth.sendall(told(HELLO))
                if fourth.recv(4):
                    break
            assert time.monotonic() < until


@pytest.mark.parametrize("name", ["a\nb", "a\x1b", "\ud800", "x" * 201, 3])
def test_a_server_has_a_name_that_can_be_shown(name):
    with pytest.raises(UserError, match="Expected name= of at most 200 printable characters"):
        sada_gym.serve(right, name=name)


@pytest.mark.parametrize("host", ["a" * 70, "a\0b", "nobody..there"])
def test_hosts_that_are_none_get_a_sentence(host):
    with pytest.raises(UserError, match="Expected to listen on"):
        sada_gym.serve(right, host=host, port=0)
    with pytest.raises(UserError, match="nothing answers there"):
        RemoteAgent(Address(host, 7788), POLE, timeout_s=1.0)


@pytest.mark.parametrize("address", ["nowhere", "127.0.0.1:1", "\0:1", ":x"])
def test_an_attack_that_is_not_there_gets_a_sentence(address, monkeypatch):
    monkeypatch.setitem(server_module.os.environ, server_module.CONNECT, address.replace("\0", "?"))
    with pytest.raises(UserError, match="Expected an attack at SADA_GYM_CONNECT="):
        sada_gym.serve(right)


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="this system has no IPv6")
def test_a_server_listens_on_ipv6(capsys):
    with socket.create_server(("::1", 0), family=socket.AF_INET6) as probe:
        port = probe.getsockname()[1]
    threading.Thread(
        target=sada_gym.serve, args=(right,), kwargs={"host": "::1", "port": port}, daemon=True
    ).start()
    until = time.monotonic() + 9.0
    while f"tcp://[::1]:{port}" not in capsys.readouterr().err:
        assert time.monotonic() < until
        time.sleep(0.02)
    agent = RemoteAgent(Address("[::1]", port), POLE, timeout_s=9.0)
    assert asked(agent, acts=True).tolist() == [1, 1, 1]
    agent.close()
