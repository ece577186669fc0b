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
from gymnasium import spaces
from safetensors.numpy import save

import sada_gym
from sada_gym.agents.contract import Interface
from sada_gym.agents.remote import server as server_module
from sada_gym.agents.remote.client import RemoteAgent
from sada_gym.agents.remote.places import Address
from sada_gym.errors import AgentLost, UserError

TIMEOUT_S = 0.4
MOST_MB = 300
POLE = Interface("any", spaces.Box(-1.0, 1.0, (4,)), spaces.Discrete(2))
THREE = np.arange(3)


def framed(content):
    return struct.pack(">I", len(content)) + content


def told(header, **arrays):
    """A message of an object, or of a text or bytes that should be one."""
    text = header if isinstance(header, str | bytes) else json.dumps(header)
    text = text if isinstance(text, bytes) else text.encode()
    return framed(save({"message": np.frombuffer(text, np.uint8), **arrays}))


def raw(about, data=b"", text=None):
    """A message of a header that safetensors did not write; beside it an object, if any."""
    if text is not None:
        end = len(data) + len(text)
        place = {"dtype": "U8", "shape": [len(text)], "data_offsets": [len(data), end]}
        about, data = {**about, "message": place}, data + text
    header = about if isinstance(about, bytes) else json.dumps(about).encode()
    return framed(struct.pack("<Q", len(header)) + header + data)


def array(dtype, shape, first=0, end=0):
    return {"dtype": dtype, "shape": shape, "data_offsets": [first, end]}


NOISE = np.random.default_rng(0).bytes(300)
NO_MESSAGES = {
    "nothing": b"",
    "half a length": b"\0\0",
    "a length alone": struct.pack(">I", 100),
    "a length of zero": framed(b""),
    "seven bytes": framed(b"1234567"),
    "a length beyond the limit": b"\xff" * 4,
    "a length of 512 MiB": struct.pack(">I", 2**29),
    "a length too short": b"\0\0\0\x09" + told({})[4:],
    "a length with the other end first": b"\x64\0\0\0" + b"x" * 100,
    "HTTP": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "TLS": b"\x16\x03\x01\x02\x00\x01",
    "a pickle": framed(b"\x80\x04\x95(cos\nsystem\n(S'true'\ntR."),
    "noise": NOISE,
    "framed noise": framed(NOISE),
    "null bytes": framed(b"\0" * 1_000),
    "a header of 2**63 bytes": framed(struct.pack("<Q", 2**63) + b"{}"),
    "a header of 2 MiB": raw(b" " * 2**21),
    "a header longer than all": framed(struct.pack("<Q", 90) + b"{}"),
    "a list as the header": raw(b"[]"),
    "a deep list": raw(b"[" * 100_000),
    "deep objects": raw(b'{"a":' * 100_000),
    "no UTF-8": raw(b'{"\xff":{}}'),
    "a lone surrogate": raw(b'{"\\ud800":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}}'),
    "a header cut off": raw(b'{"message":{"dtype":"U8"'),
    "no arrays": raw(b"{}"),
    "arrays that overlap": raw({"a": array("U8", [4], 0, 4), "b": array("U8", [4], 0, 4)}, b"1234"),
    "an offset of 10**30": raw({"a": array("U8", [4], 0, 10**30)}, b"1234"),
    "an offset below zero": raw({"a": array("U8", [4], -4, 0)}, b"1234"),
    "a shape for other bytes": raw({"a": array("U8", [5], 0, 4)}, b"1234"),
    "a shape of 10**30": raw({"a": array("U8", [0, 10**30])}, text=b"{}"),
    "a shape that overflows": raw({"a": array("F64", [2**40, 2**40])}, text=b"{}"),
    "70 dimensions": raw({"a": array("U8", [1] * 70, 0, 1)}, b"1", b"{}"),
    "a dimension of text": raw({"a": array("U8", ["1"], 0, 1)}, b"1", b"{}"),
    "objects": raw({"a": array("O", [1], 0, 8)}, b"12345678", b"{}"),
    "BF16": raw({"a": array("BF16", [1], 0, 2)}, b"12", b"{}"),
    "complex numbers": told("{}", a=np.zeros(2, np.complex64)),
    "an object that is no JSON": told("{x"),
    "an object that is cut off": told('{"type":'),
    "an object that is no UTF-8": told(b'{"type": "\xff"}'),
    "an object that is deep": told("[" * 10_000),
    "an object that is a number": told("3"),
    "an object with NaN": told('{"type": "hello", "number": NaN}'),
    "an object with a surrogate": told('{"type": "\\ud800"}'),
    "an object without a type": told("{}"),
    "an object of an odd type": told({"type": ["hello"], "number": 1}),
    "an object of another type": told({"type": "\x1b[2J", "number": 1}),
    "a number that is a text": told({"type": "hello", "number": "1"}),
    "a number of 10**30": told({"type": "hello", "number": 10**30}),
    "a number below zero": told({"type": "hello", "number": -1}),
    "an object of 2 MiB": told(" " * 2**21),
    "protocol 1": framed(b'{"type": "hello", "protocol": 1, "name": "old", "arrays": []}'),
}
"""What is no message, from either side."""

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


def drip(content):
    def send(connection):
        for byte in content:
            connection.sendall(bytes([byte]))
            time.sleep(TIMEOUT_S / 20)

    return send


def wait(connection):
    time.sleep(2 * TIMEOUT_S)


BEHAVIOURS = {
    "drips": drip(told(WELCOME)),
    "drips no message": drip(framed(b"\0" * 500)),
    "never answers": wait,
    "answers late": lambda connection: (wait(connection), connection.sendall(told(WELCOME))),
    "resets": lambda connection: connection.setsockopt(
        socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
    ),
    "closes in the middle": lambda connection: connection.sendall(told(WELCOME)[:-5]),
    "stops in the middle": lambda connection: (
        connection.sendall(told(WELCOME)[:-5]),
        wait(connection),
    ),
    "writes without an end": lambda connection: [connection.sendall(NOISE) for _ in range(10**6)],
}


def received(connection):
    """Read one message without looking at it."""
    (length,) = struct.unpack(">I", connection.recv(4, socket.MSG_WAITALL))
    return connection.recv(length, socket.MSG_WAITALL)


def broken_server(*answers):
    """Answer the first questions of one connection, by bytes or by what a function does."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve():
        with listening, suppress(OSError), listening.accept()[0] as connection:
            for answer in answers:
                received(connection)
                answer(connection) if callable(answer) else connection.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    return Address("127.0.0.1", listening.getsockname()[1])


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
    with pytest.raises(UserError, match="nobody is there"):
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
