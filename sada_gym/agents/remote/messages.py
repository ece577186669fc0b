"""The messages between an attack and an agent's process: a header in JSON, then raw arrays.

A message is the length of its header, four bytes, most significant first; the header, an object in
JSON; and the bytes of the arrays that the header's `arrays` lists by name, dtype and shape, one
behind the other, each in C order. Nothing is ever unpickled.
"""

from __future__ import annotations

import json
import math
import os
import re
import select
import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import ALONE

PROTOCOL = 1
CONNECT = "SADA_GYM_CONNECT"
"""The environment variable that tells a started program where to connect: host:port."""

CONNECT_UNIX = "SADA_GYM_CONNECT_UNIX"
"""The path of a Unix socket, a faster way to the same place, on systems that have them."""

MAX_HEADER_BYTES = 64 * 2**20
MAX_ARRAY_BYTES = 2**31
OBSERVATION = "observation"
"""The array of observations that are no dictionaries; a part of others is `observation.KEY`."""

_AWAKE_S = 0.5e-3
"""How long a side that waits stays awake; to be woken costs as much as a small network's answer."""
_AWAY_S = 50e-6
"""A look at the connection that takes longer: another process needed the core."""
_ASLEEP = 16
"""How many messages are waited for asleep after that."""

_LENGTH = struct.Struct(">I")
_DTYPE = re.compile(r"[<>|]?[biuf][1248]")
Array = npt.NDArray[Any]
Message = tuple[dict[str, Any], dict[str, Array]]


class Nonsense(Exception):  # noqa: N818 - reads as what came
    """Something that is no message of the protocol."""


@dataclass(frozen=True)
class _Listed:
    """What a header says of one array."""

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @cached_property
    def size(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    @classmethod
    def of(cls, about: Any) -> _Listed:
        about = about if isinstance(about, dict) else {}
        name, dtype, shape = (about.get(key) for key in ("name", "dtype", "shape"))
        if (
            not isinstance(name, str)
            or not _DTYPE.fullmatch(str(dtype))
            or not isinstance(shape, list)
            or not all(type(size) is int and size >= 0 for size in shape)
        ):
            raise Nonsense(f"an array described by {str(about)[:200]}")
        try:
            listed = cls(name, np.dtype(str(dtype)), tuple(shape))
        except TypeError as error:
            raise Nonsense(f"an array of the dtype {dtype}") from error
        if listed.size > MAX_ARRAY_BYTES:
            raise Nonsense(f"an array of {listed.size:,} bytes")
        return listed


class Channel:
    """Messages over one connection; without a timeout it waits for ever.

    Most headers are those of the last message, and are not written or read again: such a message
    comes with the same dictionary.
    """

    def __init__(self, connection: socket.socket, timeout_s: float | None = None) -> None:
        if connection.family in (socket.AF_INET, socket.AF_INET6):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(timeout_s)
        self._connection, self._incoming = connection, connection.makefile("rb")
        self._asleep = 0
        self._sent: tuple[Any, bytes] = (None, b"")
        self._got: tuple[bytes, dict[str, Any], list[_Listed]] = (b"", {}, [])

    def close(self) -> None:
        """Close the connection."""
        self._incoming.close()
        self._connection.close()

    def send(self, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        """Send one message; it raises OSError if the other side is gone."""
        kinds = [(name, array.dtype, array.shape) for name, array in arrays.items()]
        known, begins = self._sent
        if known != (header, kinds):
            listed = [
                {"name": name, "dtype": dtype.str, "shape": shape} for name, dtype, shape in kinds
            ]
            text = json.dumps({**header, "arrays": listed}).encode()
            begins = _LENGTH.pack(len(text)) + text
            self._sent = ((header, kinds), begins)
        raw = [array.tobytes() for array in arrays.values()]
        self._connection.sendall(b"".join([begins, *raw]))

    def receive(self) -> Message | None:
        """Wait for one message; None where the other side has closed the connection.

        It raises `Nonsense` if what comes is no message, and OSError if nothing comes in time.
        """
        self._wait_awake()
        begins = self._incoming.read(_LENGTH.size)
        if not begins:
            return None
        if len(begins) < _LENGTH.size:
            raise Nonsense("half a message")
        (length,) = _LENGTH.unpack(begins)
        if not 2 <= length <= MAX_HEADER_BYTES:
            raise Nonsense(f"a header of {length:,} bytes")
        text = self._read(length)
        if text != self._got[0]:
            self._got = (text, *_parsed(text))
        _, header, listed = self._got
        return header, {entry.name: self._read_array(entry) for entry in listed}

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

    def _read_array(self, entry: _Listed) -> Array:
        array = np.frombuffer(self._read(entry.size), entry.dtype)
        return array.reshape(entry.shape).copy()

    def _read(self, count: int) -> bytes:
        content = self._incoming.read(count)
        if len(content) < count:
            raise Nonsense("half a message")
        return content


def _parsed(text: bytes) -> tuple[dict[str, Any], list[_Listed]]:
    try:
        header: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Nonsense("a header that is no JSON") from error
    listed = header.get("arrays", []) if isinstance(header, dict) else None
    if not isinstance(listed, list):
        raise Nonsense("a header that is no object, or has no list of arrays")
    return header, [_Listed.of(about) for about in listed]


def array_name(key: str) -> str:
    """Return the name of the array of a part of the observations, see `keyed`."""
    return OBSERVATION if key == ALONE else f"{OBSERVATION}.{key}"


def space_to_json(space: spaces.Space[Any]) -> dict[str, Any]:
    """Describe a space as data for JSON; a bound that is infinite is null."""
    kind = type(space).__name__
    if isinstance(space, spaces.Dict):
        return {"kind": kind, "spaces": {key: space_to_json(part) for key, part in space.items()}}
    if isinstance(space, spaces.Box):
        bounds = {name: _bound(getattr(space, name)) for name in ("low", "high")}
        return {"kind": kind, "shape": [*space.shape], "dtype": space.dtype.str, **bounds}
    if isinstance(space, spaces.Discrete):
        return {"kind": kind, "n": int(space.n), "start": int(space.start)}
    if isinstance(space, spaces.MultiDiscrete):
        sizes = {"nvec": space.nvec.tolist(), "start": space.start.tolist()}
        return {"kind": kind, "dtype": space.dtype.str, **sizes}
    assert isinstance(space, spaces.MultiBinary)
    return {"kind": kind, "shape": [*(space.shape or ())]}


def _bound(values: Array) -> Any:
    """Return one number where all are the same, else nested lists."""
    numbers = values.astype(object)
    numbers[~np.isfinite(values)] = None
    flat = numbers.ravel().tolist()
    return flat[0] if flat and all(number == flat[0] for number in flat) else numbers.tolist()


def space_from_json(entry: Any) -> spaces.Space[Any]:
    """Make a space of its description; raise `Nonsense` if it is none."""
    try:
        kind = entry["kind"]
        if kind == "Dict":
            parts = {key: space_from_json(part) for key, part in entry["spaces"].items()}
            return spaces.Dict(parts)
        if kind == "Box":
            dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
            low, high = (
                np.broadcast_to(np.where(given == None, end, given).astype(dtype), shape)  # noqa: E711
                for given, end in (
                    (np.array(entry["low"], object), -np.inf),
                    (np.array(entry["high"], object), np.inf),
                )
            )
            return spaces.Box(low, high, shape, dtype.type)
        if kind == "Discrete":
            return spaces.Discrete(entry["n"], start=entry["start"])
        if kind == "MultiDiscrete":
            dtype = np.dtype(entry["dtype"])
            return spaces.MultiDiscrete(entry["nvec"], dtype.type, start=entry["start"])
        if kind == "MultiBinary":
            return spaces.MultiBinary(entry["shape"])
    except (KeyError, TypeError, ValueError, AttributeError, AssertionError) as error:
        raise Nonsense(f"a space described by {str(entry)[:200]}") from error
    raise Nonsense(f"a space of the kind {kind!r}")
