"""The messages between an attack and an agent's process: arrays in safetensors' format.

A message is its length, four bytes, most significant first, and so many bytes in safetensors'
format. `multiprocessing.connection` writes and reads bytes in the same way; it is not used here,
for it cannot stop to wait. The array `message` holds an object in JSON. Nothing is ever unpickled.
"""

from __future__ import annotations

import json
import os
import select
import socket
import struct
import time
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load

from sada_gym.agents.remote.spaces import NAMES, Array, Described, Name
from sada_gym.agents.tile import ALONE
from sada_gym.errors import UserError
from sada_gym.foundations.files import Strict, first_error, shown

PROTOCOL: Final = 2
CONNECT = "SADA_GYM_CONNECT"
"""The environment variable that tells a started program where to connect: host:port."""

CONNECT_UNIX = "SADA_GYM_CONNECT_UNIX"
"""The path of a Unix socket, a faster way to the same place, on systems that have them."""

MAX_ARRAY_BYTES = 2**29
"""The limit of the arrays of a message."""

MAX_HEADER_BYTES = 2**20
"""The limit of what describes these arrays, and of the object in JSON."""

MAX_ROWS = 2**16
OBSERVATION = "observation"
"""The array of observations that are no dictionaries; a part of others is `observation.KEY`."""

_AWAKE_S = 0.5e-3
"""How long a side that waits stays awake; to be woken costs as much as a small network's answer."""
_AWAY_S = 50e-6
"""A look at the connection that takes longer: another process needed the core."""
_ASLEEP = 16
"""How many messages are waited for asleep after that."""

_CHUNK_BYTES = 2**20
_LENGTH = struct.Struct(">I")


class Nonsense(Exception):  # noqa: N818 - reads as what came
    """Something that is no message of the protocol."""


class Unexpected(Nonsense):
    """A whole message whose object in JSON is none that is expected."""


class OldProtocol(Nonsense):
    """A message of the first protocol, which had another format."""


class _Header(Strict, strict=True):
    number: Annotated[int, Field(ge=0, lt=2**63)]
    """A question's number, which its answer repeats."""


class Hello(_Header):
    """The first question: what the agent would see and do."""

    type: Literal["hello"] = "hello"
    protocol: Literal[2]
    environment: Name
    observation_space: Described
    action_space: Described
    wrapped_by: Annotated[tuple[Name, ...], Field(max_length=100)]
    action_masks: bool
    deterministic: bool


class Act(_Header):
    """A question for actions; its arrays are observations and more."""

    type: Literal["act"] = "act"
    start: bool
    count: Annotated[int, Field(ge=0, le=MAX_ROWS)]


class Welcome(_Header):
    """The answer to `Hello`."""

    type: Literal["hello"] = "hello"
    protocol: Literal[2]
    name: Name | None = None
    fingerprint: Name | None = None
    rows: Annotated[int, Field(ge=0, le=MAX_ROWS)] = 16
    action_masks: bool = False


class Actions(_Header):
    """The answer to `Act`; its array is `actions`."""

    type: Literal["actions"] = "actions"


class Failed(_Header):
    """An answer that says what is wrong."""

    type: Literal["error"] = "error"
    message: str


QUESTIONS: TypeAdapter[Hello | Act] = TypeAdapter(
    Annotated[Hello | Act, Field(discriminator="type")]
)
ANSWERS: TypeAdapter[Welcome | Actions | Failed] = TypeAdapter(
    Annotated[Welcome | Actions | Failed, Field(discriminator="type")]
)
HeaderT = TypeVar("HeaderT")


class Channel:
    """Messages over one connection, each within so many seconds of its begin."""

    def __init__(self, connection: socket.socket, within_s: float) -> None:
        if connection.family in (socket.AF_INET, socket.AF_INET6):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection, self._within_s, self._asleep = connection, within_s, 0
        # most messages are laid out as the last one was
        self._sent: tuple[list[Any], bytes] = ([], b"")
        self._got: tuple[Any, list[Any]] = (None, [])

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def deadline(self) -> float:
        """Return the time when what begins now must have ended."""
        return time.monotonic() + self._within_s

    def send(self, header: Strict, arrays: Mapping[str, Array], until: float) -> None:
        """Send one message; raise OSError if the other side is gone, or does not read it in time.

        It raises `UserError` if the message is too large.
        """
        text = np.frombuffer(header.model_dump_json().encode(), np.uint8)
        size = sum(array.nbytes for array in arrays.values())
        if size > MAX_ARRAY_BYTES:
            raise UserError(
                f"Expected at most {MAX_ARRAY_BYTES:,} bytes in a message, got {size:,}. Let the "
                "server say fewer rows, or shrink the observations by a wrapper."
            )
        self._send(self._packed({"message": text, **arrays}), until)

    def _packed(self, arrays: Mapping[str, Array]) -> bytes:
        layout = [(name, array.dtype, array.shape) for name, array in arrays.items()]
        if self._sent[0] != layout:
            header, end = dict[str, Any](), 0
            for name, array in arrays.items():
                first, end = end, end + array.nbytes
                about = {"dtype": NAMES[array.dtype], "shape": array.shape}
                header[name] = {**about, "data_offsets": [first, end]}
            text = json.dumps(header).encode()
            self._sent = layout, len(text).to_bytes(8, "little") + text
        return b"".join([self._sent[1], *(array.tobytes() for array in arrays.values())])

    def refuse_old(self, sentence: str) -> None:
        """Send an error as a message of the first protocol."""
        self._send(json.dumps({"type": "error", "message": sentence}).encode(), self.deadline())

    def _send(self, content: bytes, until: float) -> None:
        self._connection.settimeout(_left(until))
        self._connection.sendall(_LENGTH.pack(len(content)) + content)

    def receive(
        self, kinds: TypeAdapter[HeaderT], until: float | None = None
    ) -> tuple[HeaderT, dict[str, Array]] | None:
        """Wait for one message; None where the other side has closed the connection.

        Args:
            kinds: The headers that are expected.
            until: When to stop; by default it waits for ever for a message to begin.

        Raises:
            Nonsense: If what comes is no message.
            OSError: If it does not come in time, or the connection breaks.
        """
        self._wait_awake()
        self._connection.settimeout(None if until is None else _left(until))
        begins = self._connection.recv(_LENGTH.size)
        if not begins:
            return None
        until = self.deadline() if until is None else until
        begins += self._read(_LENGTH.size - len(begins), until)
        (length,) = _LENGTH.unpack(begins)
        if length > MAX_ARRAY_BYTES + 2 * MAX_HEADER_BYTES:
            raise Nonsense(f"a message of {length:,} bytes")
        return self._parsed(self._read(length, until), kinds)

    def _wait_awake(self) -> None:
        """Wait a moment for a message without sleeping, unless others need the core."""
        if self._asleep or not hasattr(os, "sched_yield"):
            self._asleep = max(0, self._asleep - 1)
            return
        poll = select.poll()
        poll.register(self._connection, select.POLLIN)
        began = now = time.perf_counter()
        while not poll.poll(0) and now - began < _AWAKE_S:
            os.sched_yield()
            before, now = now, time.perf_counter()
            if now - before > _AWAY_S:
                self._asleep = _ASLEEP
                return

    def _read(self, count: int, until: float) -> bytes:
        content = bytearray()  # grows with what comes, whatever length was announced
        while len(content) < count:
            self._connection.settimeout(_left(until))
            chunk = self._connection.recv(min(count - len(content), _CHUNK_BYTES))
            if not chunk:
                raise Nonsense("half a message")
            content += chunk
        return bytes(content)

    def _parsed(
        self, content: bytes, kinds: TypeAdapter[HeaderT]
    ) -> tuple[HeaderT, dict[str, Array]]:
        begin = 8 + int.from_bytes(content[:8], "little")
        if begin > MAX_HEADER_BYTES:
            old = content.startswith(b"{")
            raise (OldProtocol if old else Nonsense)("a message that is none of safetensors")
        key = content[:begin], len(content)
        try:
            if self._got[0] != key:
                header = json.loads(content[8:begin]) if (loaded := load(content)) else {}
                layout = [
                    (name, array.shape, array.dtype, begin + header[name]["data_offsets"][0])
                    for name, array in loaded.items()
                ]
                self._got = key, layout
            arrays = {
                name: np.ndarray(shape, dtype, content, first).copy()
                for name, shape, dtype, first in self._got[1]
            }
            text = arrays.pop("message")
        except (SafetensorError, ValueError, LookupError, OverflowError, TypeError) as error:
            reason = shown(f"{type(error).__name__}: {error}")
            raise Nonsense(f"a message that is none of safetensors ({reason})") from error
        unknown = [array.dtype for array in arrays.values() if array.dtype not in NAMES]
        if unknown or text.nbytes > MAX_HEADER_BYTES:
            raise Nonsense(f"arrays of {unknown[:3]}, or an object of {text.nbytes:,} bytes")
        try:
            return kinds.validate_json(text.tobytes()), arrays
        except ValidationError as error:
            raise Unexpected(f"a message with {first_error(error, 'its object')}") from error


def _left(until: float) -> float:
    """Return the seconds to a time; raise TimeoutError if it is past."""
    if (left := until - time.monotonic()) <= 0:
        raise TimeoutError("timed out")
    return left


def array_name(key: str) -> str:
    """Return the name of the array of a part of the observations, see `keyed`."""
    return OBSERVATION if key == ALONE else f"{OBSERVATION}.{key}"
