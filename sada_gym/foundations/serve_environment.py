#!/usr/bin/env python3
"""Serve an environment to attacks of sada_gym, from a Python that may lack sada_gym.

    python serve_environment.py CartPole-v1
    python serve_environment.py safety_gymnasium:SafetyPointGoal1-v0 --port 7789
    python serve_environment.py my_module:make_environment --keyword wind=3.5
    python serve_environment.py dm_control:cartpole-balance

This one file needs Python 3.8 or later and NumPy alone: copy it to where the environment is. It
takes environments of Gymnasium, of gym 0.21 to 0.26, and of dm_control. Each connection is served
by a process of its own where the system can fork. Nothing that comes is run or unpickled.

A message is its length, four bytes, most significant first, and so many bytes in safetensors'
format. `multiprocessing.connection` writes and reads bytes in the same way; it is not used here,
for it cannot stop to wait. The array `message` holds an object in JSON.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib
import inspect
import json
import math
import os
import select
import signal
import socket
import struct
import sys
import threading
import time
import traceback
from copy import deepcopy
from functools import partial
from importlib import metadata
from typing import Any, Callable, Final, Mapping  # noqa: UP035 - Python 3.8 has these alone

try:
    import numpy as np
except ImportError:
    sys.exit(
        f"Expected NumPy in {sys.executable}, found none. "
        f"Install it there: {sys.executable} -m pip install numpy"
    )

PROTOCOL: Final = 2
PORT = 7789
CONNECT = "SADA_GYM_CONNECT"
"""The environment variable that tells a started program where to connect: host:port."""

CONNECT_UNIX = "SADA_GYM_CONNECT_UNIX"
"""The path of a Unix socket, a faster way to the same place, on systems that have them."""

MAX_ARRAY_BYTES = 2**29
"""The limit of the arrays of a message."""

MAX_HEADER_BYTES = 2**20
"""The limit of what describes these arrays, and of the object in JSON."""

MAX_ENVIRONMENTS = 2**16
"""How many environments one connection may number."""

PATIENCE_S = 60.0
"""How long a message may take that has begun, and the first one to come."""

_AWAKE_S = 0.5e-3
"""How long a side that waits stays awake; to be woken costs as much as a small network's answer."""
_AWAY_S = 50e-6
"""A look at the connection that takes longer: another process needed the core."""
_ASLEEP = 16
"""How many messages are waited for asleep after that."""
_GRACE_S = 10.0
"""How long an environment may go on after its attack has gone."""

_DEEPEST, _LONGEST, _CONNECTIONS, _CHUNK_BYTES = 32, 2_000, 128, 2**20
_LENGTH = struct.Struct(">I")
_ENGINES = ("gymnasium", "gym", "dm_control", "mujoco", "mujoco_py", "pybullet", "Box2D")
_WARNINGS = ("INERTIA", "CONTACTFULL", "CNSTRFULL", "BADQPOS", "BADQVEL", "BADQACC")
"""MuJoCo's warnings of a simulation that went wrong. BADCTRL is the agent's, VGEOMFULL a picture's.

After the last three MuJoCo resets the simulation on its own, and the episode goes on from there.
"""

DTYPES = {
    name: np.dtype(bool if name == "BOOL" else name[0].lower() + str(int(name[1:]) // 8))
    for name in ("BOOL", "U8", "U16", "U32", "U64", "I8", "I16", "I32", "I64", "F16", "F32", "F64")
}
"""NumPy's types of numbers by safetensors' names."""

NAMES = {dtype: name for name, dtype in DTYPES.items()}
_CONTAINERS = (list, dict, np.ndarray)


class Nonsense(Exception):  # noqa: N818 - reads as what came
    """Something that is no message of the protocol."""


class OldProtocol(Nonsense):
    """A message of the first protocol, which had another format."""


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

    def put(self, text: bytes, arrays: Mapping[str, Any], until: float) -> None:
        """Send an object in JSON and arrays; raise OSError if the other side does not take them.

        It raises ValueError if they are too large.
        """
        arrays = {"message": np.frombuffer(text, np.uint8), **arrays}
        layout = [(name, array.dtype, array.shape) for name, array in arrays.items()]
        if self._sent[0] != layout:
            header, end = {}, 0
            for name, array in arrays.items():
                first, end = end, end + array.nbytes
                about = {"dtype": NAMES[array.dtype], "shape": array.shape}
                header[name] = {**about, "data_offsets": [first, end]}
            head = json.dumps(header).encode()
            if max(len(text), len(head)) > MAX_HEADER_BYTES or end > MAX_ARRAY_BYTES + len(text):
                raise ValueError(f"{end:,} bytes are more than a message holds")
            self._sent = layout, len(head).to_bytes(8, "little") + head
        self.put_raw(b"".join([self._sent[1], *(a.tobytes() for a in arrays.values())]), until)

    def put_raw(self, content: bytes, until: float) -> None:
        """Send bytes and their length."""
        self._connection.settimeout(_left(until))
        self._connection.sendall(_LENGTH.pack(len(content)) + content)

    def take(self, until: float | None = None) -> tuple[bytes, dict[str, Any]] | None:
        """Wait for an object in JSON and arrays; None where the other side has closed.

        By default it waits for ever for a message to begin. It raises `Nonsense` for what is no
        message, and OSError if it does not come in time, or the connection breaks.
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
        return self._parsed(self._read(length, until))

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

    def _parsed(self, content: bytes) -> tuple[bytes, dict[str, Any]]:
        begin = 8 + int.from_bytes(content[:8], "little")
        if begin > MAX_HEADER_BYTES:
            old = content.startswith(b"{")
            raise (OldProtocol if old else Nonsense)("a message that is none of safetensors")
        key = content[:begin], len(content)
        try:
            if self._got[0] != key:
                self._got = key, _layout(json.loads(content[8:begin]), len(content) - begin)
            arrays = {
                name: np.ndarray(shape, dtype, content, begin + first).copy()
                for name, shape, dtype, first in self._got[1]
            }
            text = arrays.pop("message").tobytes()
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            told = f"{type(error).__name__}: {error}"[:200].encode("unicode_escape").decode()
            raise Nonsense(f"a message that is none of safetensors ({told})") from error
        if len(text) > MAX_HEADER_BYTES:
            raise Nonsense(f"an object of {len(text):,} bytes")
        return text, arrays


def _left(until: float) -> float:
    """Return the seconds to a time; raise a time-out if it is past."""
    if (left := until - time.monotonic()) <= 0:
        raise socket.timeout("timed out")  # noqa: UP041 - another error before Python 3.10
    return left


def _layout(header: Any, size: int) -> list[Any]:
    """Return what a header says of its arrays; raise ValueError if they do not fill `size` bytes.

    It raises what Python raises where the header is no such object.
    """
    layout, end = [], 0
    for name, about in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
        (first, last), shape, dtype = about["data_offsets"], about["shape"], DTYPES[about["dtype"]]
        if len(shape) > 16 or not all(type(n) is int and 0 <= n < 2**40 for n in (last, *shape)):
            raise ValueError(f"an array of the shape {str(shape)[:99]}")
        if first != end or math.prod(shape) * dtype.itemsize != last - first:
            raise ValueError("arrays that do not lie one after another")
        layout.append((name, shape, dtype, first))
        end = last
    if end != size:
        raise ValueError("bytes after the last array")
    return layout


class Opaque:
    """Stands for a value that no message can hold, such as a simulator's model."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __repr__(self) -> str:
        """Name the kind of object."""
        return f"<{self.kind} in another process>"

    def __deepcopy__(self, memo: Any) -> Opaque:
        """Return itself: `MISSING` is one object."""
        return self


MISSING = Opaque("nothing")
"""What an attribute is that does not exist."""


def encode(value: Any, arrays: dict[str, Any], depth: int = 0) -> Any:
    """Return a value as data for JSON; its arrays are put into `arrays`."""
    if value is None or value is True or value is False:
        return value
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.newbyteorder("=") in NAMES:
        name = str(len(arrays))
        arrays[name] = np.asarray(value, value.dtype.newbyteorder("="))
        return {"array" if isinstance(value, np.ndarray) else "scalar": name}
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, int) and abs(int(value)) < 2**63:
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, slice):
        return {"slice": [value.start, value.stop, value.step]}
    if isinstance(value, (list, tuple, Mapping)) and depth < _DEEPEST:
        if isinstance(value, Mapping):
            items = [[encode(part, arrays, depth + 1) for part in item] for item in value.items()]
            return {"dict": items}
        parts = [encode(part, arrays, depth + 1) for part in value]
        return parts if isinstance(value, list) else {"tuple": parts}
    return {"object": value.kind if isinstance(value, Opaque) else type(value).__name__[:99]}


def decode(tree: Any, arrays: Mapping[str, Any], depth: int = 0) -> Any:
    """Return the value that `encode` was given; raise ValueError for what it never returns."""
    if depth > 2 * _DEEPEST:
        raise ValueError("a value that is too deep")
    if isinstance(tree, list):
        return [decode(part, arrays, depth + 1) for part in tree]
    if not isinstance(tree, dict):
        return tree
    try:
        ((kind, content),) = tree.items()
        if kind in ("array", "scalar"):
            return arrays[content] if kind == "array" else arrays[content][()]
        if kind == "tuple":
            return tuple([decode(part, arrays, depth + 1) for part in content])
        if kind == "dict":
            return {
                decode(key, arrays, depth + 1): decode(part, arrays, depth + 1)
                for key, part in content
            }
        if kind == "float":
            return {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}[content]
        if kind == "slice":
            first, stop, step = content
            return slice(first, stop, step)
        if kind == "object":
            return MISSING if content == "nothing" else Opaque(str(content))
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"no value that can be read ({error})") from error
    raise ValueError(f"a value of the kind {kind[:99]!r}")


def mujoco_model(world: Any) -> Any:
    """Return the MuJoCo model of an unwrapped environment, or None."""
    model = getattr(world, "__dict__", {}).get("model")
    return model if type(model).__module__.partition(".")[0] == "mujoco" else None


def mujoco_fault(world: Any) -> str:
    """Say what went wrong in a MuJoCo simulation; empty if nothing did, or without MuJoCo.

    It finds a negative mass or inertia, a timestep that is not positive, and MuJoCo's warnings: a
    state that is too fast or not finite, after which MuJoCo resets itself; a singular inertia
    matrix; more contacts than fit its memory.
    """
    model, data = mujoco_model(world), getattr(world, "data", None)
    if model is None or data is None or not hasattr(data, "warning"):
        return ""
    mujoco = importlib.import_module("mujoco")
    for what in ("body_mass", "body_inertia"):
        if not (getattr(model, what) >= 0.0).all():
            return f"its {what} is negative or NaN"
    if not model.opt.timestep > 0.0:
        return f"its timestep is {model.opt.timestep:g}"
    for warning in _WARNINGS:
        number = int(data.warning[getattr(mujoco.mjtWarning, f"mjWARN_{warning}")].number)
        if number:
            return f"MuJoCo warned of {warning}"
    return ""


def update_model(model: Any) -> None:
    """Let MuJoCo compute anew what follows from its model, such as the masses of subtrees."""
    model = getattr(model, "ptr", model)  # dm_control's
    of_mujoco = type(model).__module__.partition(".")[0] == "mujoco"
    if of_mujoco and hasattr(model, "body_mass") and (model.body_mass >= 0).all():
        mujoco = importlib.import_module("mujoco")
        mujoco.mj_setConst(model, mujoco.MjData(model))


class _Gym:
    """An environment of Gymnasium, or of gym 0.21 to 0.26."""

    def __init__(self, env: Any, limit: int | None) -> None:
        self.env, self.world, self.limit, layer = env, env.unwrapped, None, env
        while layer is not self.world:
            if hasattr(layer, "_max_episode_steps"):  # a TimeLimit
                self.limit = layer._max_episode_steps = limit or layer._max_episode_steps
            layer = layer.env
        known, any_keyword = _defaults_of(self.world.reset)
        self._takes = [name for name in ("seed", "options") if any_keyword or name in known]
        self._modes = "mode" in _defaults_of(self.world.render)[0]
        self.metadata = dict(getattr(env, "metadata", None) or {})

    @property
    def spaces(self) -> tuple[Any, Any]:
        return self.env.observation_space, self.env.action_space

    def reset(self, seed: Any, options: Any) -> tuple[Any, Any]:
        given = {"seed": seed, "options": options}
        if options is not None and "options" not in self._takes:
            raise TypeError("reset() got an unexpected keyword argument 'options'")
        if "seed" not in self._takes and seed is not None:
            self.env.seed(seed)
        begun = self.env.reset(**{name: given[name] for name in self._takes})
        pair = isinstance(begun, tuple) and len(begun) == 2 and isinstance(begun[1], dict)
        return begun if pair else (begun, {})

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, Any]:
        seen, reward, *cost, ended, info = given = self.env.step(action)
        if len(given) == 4:
            cut = bool(info.get("TimeLimit.truncated", False))
            return seen, reward, bool(ended) and not cut, cut, info
        if len(given) == 6:  # safety_gymnasium's
            info = {**info, "cost": cost.pop(0)}
        (terminated,) = cost
        return seen, reward, bool(terminated), bool(ended), info

    def render(self) -> Any:
        frame = self.env.render(mode="rgb_array") if self._modes else self.env.render()
        return frame[-1] if isinstance(frame, list) else frame

    def close(self) -> None:
        self.env.close()


class _Control:
    """An environment of dm_control's interface."""

    def __init__(self, env: Any) -> None:
        self.env = self.world = env
        most = getattr(env, "_step_limit", math.inf)
        self.limit = int(most) if math.isfinite(most) else None
        self.metadata = {"render_modes": ["rgb_array"]} if hasattr(env, "physics") else {}

    @property
    def spaces(self) -> tuple[Any, Any]:
        return self.env.observation_spec(), self.env.action_spec()

    def reset(self, seed: Any, options: Any) -> tuple[Any, Any]:
        homes = [self.env, getattr(self.env, "task", None)]
        found = [getattr(home, name, None) for home in homes for name in ("random", "random_state")]
        randoms = [one for one in found if isinstance(one, np.random.RandomState)]
        if options or not randoms:
            raise TypeError("reset() takes no options, and seeds task.random or random_state")
        for random in randoms:
            random.seed(seed)
        return self.env.reset().observation, {}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, Any]:
        moment = self.env.step(action)
        over, terminated = bool(moment.last()), bool(moment.last()) and moment.discount == 0.0
        reward = 0.0 if moment.reward is None else moment.reward
        return moment.observation, reward, terminated, over and not terminated, {}

    def render(self) -> Any:
        return self.env.physics.render(height=240, width=320, camera_id=0)

    def close(self) -> None:
        getattr(self.env, "close", lambda: None)()


def describe(space: Any, name: str, arrays: dict[str, Any]) -> dict[str, Any]:
    """Describe a space or a spec; bounds that differ are put into `arrays`, named after it.

    A bound is one number, None where it is infinite, or the name of an array.
    """
    kind, parts = type(space).__name__, getattr(space, "spaces", space)
    if isinstance(parts, Mapping):
        described = {key: describe(part, f"{name}.{key}", arrays) for key, part in parts.items()}
        return {"kind": "Dict", "parts": described}
    kinds = ("Discrete", "MultiDiscrete", "MultiBinary", "Box")
    kind = next((one.__name__ for one in type(space).__mro__ if one.__name__ in kinds), kind)
    shape, dtype = getattr(space, "shape", None) or (), getattr(space, "dtype", None)
    dtype = np.dtype(object if dtype is None else dtype)
    low: Any = 0
    high: Any = 1
    if kind == "Box":
        low, high = space.low, space.high
    elif kind in ("Discrete", "MultiDiscrete"):
        low = getattr(space, "start", 0)
        high = low + (space.n if kind == "Discrete" else space.nvec) - 1
    elif kind == "DiscreteArray":  # of dm_control, as the next ones
        kind, high = "Discrete", space.num_values - 1
    elif kind in ("Array", "BoundedArray"):
        kind, whole = "Box", dtype.kind in "iu"
        if dtype.kind != "b":
            least, most = (
                (np.iinfo(dtype).min, np.iinfo(dtype).max) if whole else (-math.inf, math.inf)
            )
            low = np.broadcast_to(getattr(space, "minimum", least), shape)
            high = np.broadcast_to(getattr(space, "maximum", most), shape)
    elif kind != "MultiBinary":
        kind = str(space)

    def bound(end: str, values: Any) -> Any:
        values = np.asarray(values)
        if values.size and (values == values.flat[0]).all():
            number = values.flat[0]
            if values.dtype.kind != "f":
                return int(number)
            return float(number) if math.isfinite(number) else None
        arrays[f"{name}.{end}"] = values
        return f"{name}.{end}"

    ends = {"low": bound("low", low), "high": bound("high", high)}
    return {"kind": kind, "shape": [*shape], "dtype": NAMES.get(dtype, str(dtype)), **ends}


def follow(holder: Any, step: Any) -> Any:
    """Return what a step of a path leads to, or `MISSING`: a name, or `(key,)` of brackets."""
    key = step if isinstance(step, str) else step[0]
    if key is step and key.startswith("__"):
        return MISSING
    try:
        if isinstance(holder, Mapping) and key in holder:
            return holder[key]
        return getattr(holder, key) if key is step else holder[key]
    except (AttributeError, IndexError, KeyError, TypeError):
        return MISSING


def assign(world: Any, steps: Any, value: Any) -> Any:
    """Set what a path leads to; return the object on the way to it that is called `model`."""
    first, last, holder, model = steps[0], steps[-1], world, None
    many = isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim > 0)
    if first not in vars(world) and (len(steps) > 1 or many):
        shared = getattr(type(world), first, None)
        if isinstance(shared, _CONTAINERS):  # of the class: other episodes share it
            setattr(world, first, deepcopy(shared))
    for step in steps[:-1]:
        holder = follow(holder, step)
        model = holder if step == "model" else model
    if not isinstance(last, str):
        holder[last[0]] = value
    elif isinstance(holder, Mapping) and last in holder:
        holder[last] = value  # type: ignore[index]
    elif isinstance(current := getattr(holder, last, None), np.ndarray) and current.ndim:
        current[...] = value  # others may hold the same array
    else:
        setattr(holder, last, value)
    return model


def _loaded(given: Any) -> tuple[Callable[..., Any], Any, str, dict[str, Any]]:
    """Return what makes an environment, the class or function behind it, its name and keywords."""
    if callable(given):
        return given, given, str(getattr(given, "__name__", type(given).__name__)), {}
    module, _, name = given.rpartition(":")
    if module == "dm_control":
        domain, _, task = name.partition("-")
        home = importlib.import_module(f"dm_control.suite.{domain}")
        load = importlib.import_module("dm_control.suite").load
        return partial(load, domain, task), getattr(home, task), name, {}
    made = getattr(importlib.import_module(module), name, None) if module else None
    if callable(made):
        return made, made, name, {}
    spec, home = _spec(name)
    if spec is None:
        package = module or "a package, as in package:ID"
        raise ValueError(f"neither gymnasium nor gym knows {name!r}, nor {package}")
    entry = spec.entry_point
    if isinstance(entry, str):
        module, _, attribute = entry.partition(":")
        entry = getattr(importlib.import_module(module), attribute)
    top = sys.modules[entry.__module__.partition(".")[0]]
    make = top.make if callable(getattr(top, "make", None)) else home.make  # safety_gymnasium's
    off = {"disable_env_checker": True} if "disable_env_checker" in _defaults_of(make)[0] else {}
    kwargs = getattr(spec, "kwargs", None) or getattr(spec, "_kwargs", {})
    return partial(make, name, **off), entry, name, dict(kwargs)


def _spec(name: str) -> tuple[Any, Any]:
    """Find an id in what is installed, at last in a plug-in that many use; None where none."""
    for plugin in ("gymnasium", "gym", "safety_gymnasium"):
        with contextlib.suppress(Exception):  # which one each version raises differs
            importlib.import_module(plugin)
            home = importlib.import_module("gym" if plugin == "gym" else "gymnasium")
            return home.spec(name), home
    return None, None


def _defaults_of(entry: Any) -> tuple[dict[str, Any], bool]:
    """Return the defaults of what a class or function takes by name, and if it takes any keyword.

    What has no default is an `Opaque`.
    """
    try:
        parameters = inspect.signature(entry).parameters.values()
    except (TypeError, ValueError):  # it is written in C
        return {}, True
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    defaults = {p.name: Opaque("no default") if p.default is p.empty else p.default for p in named}
    return defaults, any(p.kind is p.VAR_KEYWORD for p in parameters)


def _digest(entry: Any) -> str:
    """Return SHA-256 over the sources of the modules of a class and its bases, or of a function."""
    digest = hashlib.sha256()
    for kind in getattr(entry, "__mro__", [entry]):
        try:
            text = inspect.getsource(sys.modules[kind.__module__])
        except (OSError, TypeError, LookupError, AttributeError):  # written in C, or typed in
            text = str(getattr(kind, "__qualname__", type(kind).__qualname__))
        digest.update(text.encode(errors="replace"))
    return digest.hexdigest()


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except (metadata.PackageNotFoundError, ValueError):
        return str(getattr(sys.modules[package], "__version__", ""))


class _Session:
    """What one connection asks, and the environments that it has made."""

    def __init__(self, given: Any, keywords: Mapping[str, Any]) -> None:
        self._make, entry, name, of_id = _loaded(given)
        self._own = dict(keywords)
        defaults, any_keyword = _defaults_of(entry)
        render = getattr(entry, "render", None)
        old = callable(render) and "mode" in _defaults_of(render)[0]
        self._takes_mode = (any_keyword or "render_mode" in defaults) and not old
        home = str(getattr(entry, "__module__", "")).partition(".")[0]
        packages = [one for one in (home, *_ENGINES) if one in sys.modules and one != "__main__"]
        self._about = {
            "name": name,
            "digest": _digest(entry),
            "packages": {package: _version(package) for package in packages},
            "python": ".".join(map(str, sys.version_info[:3])),
            "any_keyword": any_keyword,
        }
        self._defaults = {**defaults, **of_id, **self._own}
        self._worlds: dict[int, Any] = {}
        self._told: dict[int, Any] = {}
        self._changed: dict[int, list[Any]] = {}
        self._greeted = False

    def answer(
        self, message: Any, sent: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the answer to a question, an object and arrays.

        It raises `Nonsense` where the connection must end.
        """
        message = message if isinstance(message, dict) else {}
        number, kind, place = (message.get(key) for key in ("number", "type", "env"))
        if type(number) is not int or not 0 <= number < 2**63 or not isinstance(kind, str):
            raise Nonsense("a message without a type and a number")
        arrays: dict[str, Any] = {}
        if kind == "hello":
            return {"type": kind, "number": number, **self._hello(message, arrays)}, arrays
        act = getattr(self, f"_do_{kind}", None)
        if not self._greeted or act is None:
            raise Nonsense(f"{kind[:99]!r} as the type of a question, or no hello before it")
        if type(place) is not int or (place in self._worlds) == (kind == "make"):
            raise Nonsense(f"the environment {str(place)[:99]} in a question {kind!r}")
        try:
            value = decode(message.get("value"), sent)
        except ValueError as error:
            raise Nonsense(str(error)) from error
        try:
            answer = {"type": "told", "value": encode(act(place, value), arrays)}
            if kind in ("make", "reset"):
                answer["spaces"] = self._spaces(place, arrays)
        except (Exception, SystemExit) as error:  # whatever an environment may raise
            answer, arrays = {"type": "raised", **_raised(error)}, {}
        return {**answer, "number": number}, arrays

    def _hello(self, message: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
        if message.get("to") != "environment":
            raise Nonsense("a hello to an agent: pass this address as environment=")
        if message.get("protocol") != PROTOCOL:
            raise Nonsense(f"protocol {str(message.get('protocol'))[:99]}")
        self._greeted = True
        keywords = {"own": encode(self._own, arrays), "keywords": encode(self._defaults, arrays)}
        return {**self._about, **keywords, "protocol": PROTOCOL}

    def _spaces(self, place: int, arrays: dict[str, Any]) -> Any:
        """Describe both spaces; None where they are what was told before."""
        new: dict[str, Any] = {}
        observation, action = self._worlds[place].spaces
        spaces = {
            "observation_space": describe(observation, "observation_space", new),
            "action_space": describe(action, "action_space", new),
        }
        told = (spaces, {name: array.tobytes() for name, array in new.items()})
        if self._told.get(place) == told:
            return None
        self._told[place] = told
        arrays.update(new)
        return spaces

    def _do_make(self, place: int, value: Any) -> Any:
        if not 0 <= place < MAX_ENVIRONMENTS:
            raise ValueError(f"environment {place}")
        keywords = {**deepcopy(self._own), **value["keywords"]}
        if value["render"] and self._takes_mode:
            keywords["render_mode"] = "rgb_array"
        env = self._make(**keywords)
        of_gym = hasattr(env, "observation_space")
        world = _Gym(env, value["limit"]) if of_gym else _Control(env)
        self._worlds[place] = world
        known = world.metadata
        return {
            "modes": [*(known.get("render_modes") or known.get("render.modes") or ())],
            "fps": known.get("render_fps") or known.get("video.frames_per_second"),
            "limit": world.limit,
            "masks": callable(getattr(world.world, "action_masks", None)),
            "bytes": resident_bytes(),
        }

    def _do_reset(self, place: int, value: Any) -> Any:
        return self._ready(place).reset(*value)

    def _do_step(self, place: int, value: Any) -> Any:
        return self._ready(place).step(value)

    def _do_render(self, place: int, value: Any) -> Any:  # noqa: ARG002
        return self._ready(place).render()

    def _ready(self, place: int) -> Any:
        """Return an environment whose MuJoCo models follow from what was set in them."""
        for model in self._changed.pop(place, ()):
            update_model(model)
        return self._worlds[place]

    def _do_get(self, place: int, value: Any) -> Any:
        found = self._worlds[place].world
        for step in value:
            found = follow(found, step)
        return Opaque("function") if callable(found) else found

    def _do_set(self, place: int, value: Any) -> None:
        model = assign(self._worlds[place].world, *value)
        if model is not None:
            self._changed.setdefault(place, []).append(model)

    def _do_names(self, place: int, value: Any) -> Any:  # noqa: ARG002
        """List all attributes, and the numbers that the object or its class holds."""
        world = self._worlds[place].world
        held = {name: one for kind in type(world).__mro__[::-1] for name, one in vars(kind).items()}
        numbers = (int, float, np.number, np.ndarray)
        held = {n: v for n, v in {**held, **vars(world)}.items() if isinstance(v, numbers)}
        return [name for name in dir(world) if name[:1] != "_"], [*held]

    def _do_masks(self, place: int, value: Any) -> Any:  # noqa: ARG002
        return np.asarray(self._worlds[place].world.action_masks(), np.bool_)

    def _do_fault(self, place: int, value: Any) -> str:  # noqa: ARG002
        return mujoco_fault(self._worlds[place].world)

    def _do_close(self, place: int, value: Any) -> None:  # noqa: ARG002
        self._told.pop(place, None)
        self._worlds.pop(place).close()

    def close(self) -> None:
        """Close all environments that are left."""
        for place in [*self._worlds]:
            with contextlib.suppress(Exception):
                self._do_close(place, None)


def _raised(error: BaseException) -> dict[str, str]:
    text = " ".join(str(error).split())
    if not text:
        at = traceback.extract_tb(error.__traceback__)[-1]
        text = f"at {os.path.basename(at.filename)}:{at.lineno} ({at.line})"
    text = text.encode(errors="backslashreplace").decode()
    return {"kind": type(error).__name__[:100], "message": text[:_LONGEST]}


def resident_bytes() -> int:
    """Return the memory that this process holds; 0 where the system does not tell it so."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _answer(connection: socket.socket, session: _Session) -> None:
    """Answer the questions of one connection to its end."""

    def put(message: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        channel.put(json.dumps(message).encode(), arrays, channel.deadline())

    channel = Channel(connection, PATIENCE_S)
    until: float | None = channel.deadline()
    with connection, contextlib.closing(session):
        try:
            while (question := channel.take(until)) is not None:
                try:
                    asked = json.loads(question[0])
                except (ValueError, RecursionError) as error:
                    raise Nonsense(f"no JSON ({error})") from error
                message, arrays = session.answer(asked, question[1])
                try:
                    put(message, arrays)
                except ValueError as error:  # it is too large
                    put({"type": "raised", "number": message["number"], **_raised(error)}, {})
                until = None
        except Nonsense as error:
            told = (
                f"Expected questions of protocol {PROTOCOL} to an environment, got {error}. Use "
                "the file serve_environment.py of the version of sada_gym that attacks."
            ).encode(errors="backslashreplace")
            _say(told.decode())
            with contextlib.suppress(OSError):
                put({"type": "error", "number": 0, "message": told.decode()}, {})
        except OSError as error:
            _say(f"A connection was closed: {error}")


def serve_environment(
    environment: Any,
    *,
    host: str = "127.0.0.1",
    port: int = PORT,
    keywords: Mapping[str, Any] | None = None,
) -> None:
    """Serve an environment to attacks until you interrupt the program.

    If an attack starts the program itself, with `environment=["python", "serve.py"]`, only that
    attack is served, and the function returns when it ends.

    Args:
        environment: An id of Gymnasium or gym, `package:id`, `module:function`,
            `dm_control:domain-task`, or a function that makes an environment.
        host: The address to listen on. With the default, only programs on this machine can connect;
            with another one, anybody who can reach that address can use the environment.
        port: The port; 0 takes a free one.
        keywords: The keywords that the constructor of each environment gets.

    Raises:
        ValueError: If there is no such environment, or the port cannot be used.
    """
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # SDL draws without a screen then
    asked_by = os.environ.get(CONNECT)
    try:
        session = _Session(environment, keywords or {})
    except (Exception, SystemExit) as error:  # whatever an import may raise
        told = "{kind}: {message}".format(**_raised(error))
        told = (
            f"Expected an environment that {sys.executable} can make, got {environment!r} "
            f"({told}). Install its package there, or fix its name."
        )
        if asked_by:
            channel = Channel(connected(), PATIENCE_S)
            channel.take(channel.deadline())  # its hello
            refusal = {"type": "error", "number": 0, "message": told}
            channel.put(json.dumps(refusal).encode(), {}, channel.deadline())
        raise ValueError(told) from error
    if asked_by:
        _answer(connected(), session)
        return
    listening, address = listen(host, port)
    children: set[int] = set()
    with listening, contextlib.suppress(KeyboardInterrupt):
        _say(f"Serving at {address}")
        while True:
            _accept(session, listening, children)
    for child in children:
        with contextlib.suppress(OSError):
            os.killpg(child, signal.SIGTERM)


def _accept(session: _Session, listening: socket.socket, children: set[int]) -> None:
    """Wait for a connection, and answer it in a process of its own where the system can fork."""
    try:
        connection, _ = listening.accept()
    except OSError as error:  # it has gone already, or there are too many open files
        _say(f"No connection was made: {error}")
        time.sleep(0.1)
        return
    if not hasattr(os, "fork"):
        _answer(connection, session)
        return
    children -= {child for child in children if os.waitpid(child, os.WNOHANG)[0]}
    parent, child = os.getpid(), 0
    with connection:
        if len(children) >= _CONNECTIONS:
            _say(f"A connection was closed: {_CONNECTIONS} are open")
            return
        child = os.fork()
        if child:
            children.add(child)
            return
        try:
            os.setsid()
            listening.close()
            watch = threading.Thread(target=_end_with, args=(connection, parent), daemon=True)
            watch.start()
            _answer(connection, session)
        finally:
            sys.stderr.flush()
            os._exit(0)


def _end_with(connection: socket.socket, parent: int) -> None:
    """End this process soon after its attack or the server has gone, even in a step that hangs."""
    poll = select.poll()
    poll.register(connection, getattr(select, "POLLRDHUP", 0))
    while not poll.poll(1_000) and os.getppid() == parent:
        pass
    time.sleep(_GRACE_S)
    os.killpg(0, signal.SIGKILL)  # with what its environments have started


def listen(host: str, port: int) -> tuple[socket.socket, str]:
    """Return a socket that listens, and its address; raise ValueError if it cannot."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family)
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise ValueError(
            f"Expected to listen on {host}:{port}, got {error}. Choose another port."
        ) from error
    where = f"[{host}]" if ":" in host else host
    return listening, f"tcp://{where}:{listening.getsockname()[1]}"


def connected() -> socket.socket:
    """Connect to the attack that started this program: by its Unix socket, or else by host:port."""
    address, path = os.environ[CONNECT], os.environ.get(CONNECT_UNIX)
    if path and hasattr(socket, "AF_UNIX"):
        connection = socket.socket(socket.AF_UNIX)
        with contextlib.suppress(OSError):  # such as in a container that has other files
            connection.connect(path)
            return connection
    host, _, port = address.rpartition(":")
    try:
        return socket.create_connection((host, int(port)))
    except (OSError, ValueError) as error:
        raise ValueError(
            f"Expected an attack at {CONNECT}={address!r}, got {error}. Unset that variable to "
            "serve without one."
        ) from error


def _say(text: str) -> None:
    print(text.encode(errors="backslashreplace").decode(), file=sys.stderr, flush=True)


def _keyword(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def main() -> None:
    """Serve what the command line names."""
    parser = argparse.ArgumentParser(description="Serve an environment to attacks of sada_gym.")
    parser.add_argument("environment", help="ID, package:ID, module:function, dm_control:NAME")
    parser.add_argument("--host", default="127.0.0.1", help="the address to listen on")
    parser.add_argument("--port", type=int, default=PORT, help=f"the port, {PORT} by default")
    parser.add_argument("--keyword", type=_keyword, action="append", metavar="KEY=VALUE")
    given = parser.parse_args()
    sys.path.insert(0, os.getcwd())
    try:
        keywords = dict(given.keyword or ())
        serve_environment(given.environment, host=given.host, port=given.port, keywords=keywords)
    except ValueError as error:
        _say(str(error))
        sys.exit(2)


if __name__ == "__main__":
    main()
