"""Messages that are none, and servers that fail, for tests of all that is asked over a socket."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from contextlib import suppress

import numpy as np
from safetensors.numpy import save

from sada_gym.agents.remote.places import Address

TIMEOUT_S = 0.4


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


def drip(content):
    def send(connection):
        for byte in content:
            connection.sendall(bytes([byte]))
            time.sleep(TIMEOUT_S / 20)

    return send


def wait(connection):
    time.sleep(2 * TIMEOUT_S)


BEHAVIOURS = {
    "drips": drip(told({"type": "hello", "number": 1, "protocol": 2})),
    "drips no message": drip(framed(b"\0" * 500)),
    "never answers": wait,
    "answers late": lambda connection: (wait(connection), connection.sendall(told({}))),
    "resets": lambda connection: connection.setsockopt(
        socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
    ),
    "closes in the middle": lambda connection: connection.sendall(told({})[:-1]),
    "stops in the middle": lambda connection: (
        connection.sendall(told({})[:-1]),
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
