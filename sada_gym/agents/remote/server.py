"""Serves an agent to attacks in other processes: `sada_gym.serve(agent)`."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym
import numpy as np
from pydantic import ValidationError

from sada_gym.agents.agent_files import find_agent_file, load_agent_file, names_model
from sada_gym.agents.contract import Agent, Indices, Interface
from sada_gym.agents.functions import agent_of
from sada_gym.agents.remote.messages import (
    MAX_ROWS,
    QUESTIONS,
    Act,
    Actions,
    Channel,
    Failed,
    Hello,
    HelloImages,
    Look,
    Unexpected,
    Welcome,
    array_name,
)
from sada_gym.agents.remote.spaces import Array
from sada_gym.agents.tile import ALONE, Batch, keyed
from sada_gym.errors import UserError, check_integer, described
from sada_gym.foundations.files import first_error, shown
from sada_gym.foundations.lazy import load
from sada_gym.foundations.serve_environment import (
    CONNECT,
    DTYPES,
    PROTOCOL,
    Nonsense,
    OldProtocol,
    connected,
    listen,
)

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

PORT = 7788

_THREADS = 128
"""How many connections are open at once: each has a thread and the spaces of its environment."""
_PATIENCE_S = 60.0
"""How long a message may take that has begun, and the first one to come."""
_BUSY_S = 0.1
_MISSING = np.empty(0, np.void)


def serve(
    agent: Any,
    *,
    host: str = "127.0.0.1",
    port: int = PORT,
    name: str | None = None,
    allow_pickle: bool = False,
    vec_normalize: str | Path | VecNormalize | Literal[False] | None = None,
) -> None:
    """Serve an agent to attacks until you interrupt the program.

    If an attack starts the program itself, with `agent=["python", "serve.py"]`, only that attack is
    served, and the function returns when it ends. Several connections are served in turn.

    Args:
        agent: What `agent=` of `GymnasiumApplication` or `ImageApplication` takes, except
            addresses and commands.
        host: The address to listen on. With the default, only programs on this machine can connect;
            with another one, anybody who can reach that address can use the agent.
        port: The port; 0 takes a free one.
        name: The agent's name in evaluation stores; change it whenever you change the agent. By
            default it is the hash of the weights, if they are known.
        allow_pickle: See `GymnasiumApplication`.
        vec_normalize: See `GymnasiumApplication`.

    Raises:
        UserError: If the port cannot be used, there is no such file, or the name has more than 200
            characters or one that cannot be printed.
    """
    file = None
    if isinstance(agent, str | Path) and not names_model(str(agent)):
        file = find_agent_file(agent)
    if vec_normalize:
        load_statistics = load("sada_gym.agents.wrappers:load_vec_normalize")
        vec_normalize = load_statistics(vec_normalize, allow_pickle=allow_pickle)
    served = _Served(file or agent, name, allow_pickle, vec_normalize)
    try:
        if CONNECT in os.environ:
            served.answer(connected())
            return
        check_integer("port", port, 0, 2**16 - 1)
        listening, address = listen(host, port)
    except ValueError as error:
        raise UserError(str(error)) from error
    with listening:
        print(f"Serving at {address}", file=sys.stderr, flush=True)
        try:
            while True:
                served.accept(listening)
        except KeyboardInterrupt:
            return


class _Served:
    """The agent that all connections share; they take turns."""

    def __init__(
        self, given: Any, name: str | None, allow_pickle: bool, normalisation: Any
    ) -> None:
        try:
            self._welcome = Welcome(number=0, protocol=PROTOCOL, name=name, rows=0)  # own tiles
        except ValidationError as error:
            raise UserError(
                f"Expected name= of at most 200 printable characters, got {first_error(error)}. "
                "Choose another name."
            ) from error
        self._given = given
        self._loaded: tuple[Any, Any] = (None, None)
        self._allow_pickle, self._normalisation = allow_pickle, normalisation
        self._turn = threading.Lock()

    def accept(self, listening: socket.socket) -> None:
        """Wait for a connection, and answer it in a thread of its own."""
        try:
            connection, _ = listening.accept()
        except OSError as error:  # it has gone already, or there are too many open files
            print(f"No connection was made: {error}", file=sys.stderr, flush=True)
            time.sleep(_BUSY_S)
            return
        if threading.active_count() > _THREADS:
            connection.close()
            print(f"A connection was closed: {_THREADS} are open", file=sys.stderr, flush=True)
        else:
            threading.Thread(target=self.answer, args=(connection,), daemon=True).start()

    def answer(self, connection: socket.socket) -> None:
        """Answer the messages of one connection to its end."""
        session: _Sessions = None
        with closing(Channel(connection, _PATIENCE_S)) as channel:
            until: float | None = channel.deadline()
            try:
                while (message := channel.receive(QUESTIONS, until)) is not None:
                    session, reply, arrays = self._reply(session, *message)
                    channel.send(reply, arrays, channel.deadline())
                    until = None if session else until
            except (OSError, Nonsense, UserError) as error:
                print(f"A connection was closed: {error}", file=sys.stderr, flush=True)
                with suppress(OSError):
                    _refuse(channel, error)

    def _reply(
        self,
        session: _Sessions,
        header: Hello | HelloImages | Act | Look,
        arrays: Mapping[str, Array],
    ) -> tuple[_Sessions, Welcome | Actions | Failed, Mapping[str, Array]]:
        """Return the session after a question, the answer's header and its arrays."""
        number = header.number
        try:
            with self._turn:
                if isinstance(header, Hello):
                    session, welcome = self._hello(header, arrays)
                elif isinstance(header, HelloImages):
                    session, welcome = self._images(header)
                elif isinstance(header, Act) and isinstance(session, _Session):
                    return session, Actions(number=number), session.act(header, arrays)
                elif isinstance(header, Look) and isinstance(session, _ImageSession):
                    return session, Actions(number=number), session.look(arrays)
                else:
                    raise UserError(f"Expected a hello first, got {header.type}. Send one.")
                return session, welcome.model_copy(update={"number": number}), {}
        except (UserError, NotImplementedError) as error:
            told = str(error)
        except Exception as error:  # whatever an agent or its file may raise
            told = f"Expected actions from the agent, got {described(error)}. Fix the agent."
        return session, _failed(told, number), {}

    def _hello(self, header: Hello, arrays: Mapping[str, Array]) -> tuple[_Session, Welcome]:
        kinds = (gym.ObservationWrapper, gym.ActionWrapper)
        try:
            observation_space = header.observation_space.made(arrays)
            action_space = header.action_space.made(arrays)
        except (ValueError, TypeError, LookupError, ArithmeticError, AssertionError) as error:
            raise UserError(
                f"Expected spaces of Gymnasium, got {described(error)}. Fix their bounds."
            ) from error
        has_masks = header.action_masks and not isinstance(action_space, gym.spaces.Box)
        if has_masks and _choices(action_space) > MAX_ROWS:
            raise UserError(
                f"Expected at most {MAX_ROWS:,} choices to mask, got {action_space}. Mask fewer."
            )
        interface = Interface(
            header.environment,
            observation_space,
            action_space,
            tuple(kind for kind in kinds if kind.__name__ in header.wrapped_by),
            has_masks,
        )
        given = self._given
        if isinstance(given, Path):
            given = self._load(given, interface)
        elif isinstance(given, Agent):
            given = deepcopy(given)  # another connection starts other episodes
        agent = agent_of(
            given,
            interface,
            self._welcome.name or str(getattr(given, "__name__", type(given).__name__)),
            normalisation=self._normalisation,
            deterministic=header.deterministic,
        )
        told = {"fingerprint": agent.fingerprint, "action_masks": has_masks}
        session = _Session(agent, interface, deterministic=header.deterministic)
        return session, self._welcome.model_copy(update=told)

    def _images(self, header: HelloImages) -> tuple[_ImageSession, Welcome]:
        """Load the model of images once for all connections that use it alike."""
        used = header.model_dump(exclude={"number"})
        if self._loaded[0] != used:
            models = import_module("sada_gym.envs.images.models")  # a room above this one
            preparation = models.Preparation(header.input_size, header.imagenet)
            model = models.find_model(self._given, header.task, preparation, header.device)
            self._loaded = used, model
        model = self._loaded[1]
        told = {"fingerprint": model.fingerprint, "task": model.task, "classes": model.names}
        return _ImageSession(model), self._welcome.model_copy(update=told)

    def _load(self, file: Path, interface: Interface) -> Any:
        """Load the agent's file once for all connections from the same environment."""
        seen = (interface.observation_space, interface.action_space)
        if self._loaded[0] != seen:
            has_statistics = self._normalisation is not None
            agent = load_agent_file(
                file, *seen, allow_pickle=self._allow_pickle, has_statistics=has_statistics
            )
            self._loaded = seen, agent
        return self._loaded[1]


class _Session:
    """The episodes of one connection, as an agent needs to see them."""

    finite_only = True

    def __init__(
        self, agent: Agent[Any, Any], interface: Interface, *, deterministic: bool
    ) -> None:
        self._agent, self._interface, self._count = agent, interface, 0
        self._arrays: Mapping[str, Array] = {}
        self._rows: dict[int, int] = {}
        self._seeds: dict[int, int] = {}
        parts = keyed(interface.observation_space)
        self._names = {key: array_name(key) for key in parts}
        self._expected: dict[str, tuple[Any, tuple[int, ...]]] = {"episodes": (np.int64, ())}
        for key, part in parts.items():
            self._expected[self._names[key]] = part.dtype, part.shape or ()
        if interface.has_masks:
            self._expected["action_masks"] = np.bool_, (_choices(interface.action_space),)
        if not deterministic:
            self._expected["seeds"] = np.uint32, ()

    def act(self, header: Act, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return the actions in some episodes, (n, ...); raise `UserError` for other arrays."""
        expected = self._expected
        if header.start or "episode_seeds" in arrays:
            expected = {**expected, "episode_seeds": (np.uint32, ())}
        rows = arrays.get("episodes", _MISSING).shape[:1]
        for name, (dtype, shape) in expected.items():
            array = arrays.get(name, _MISSING)
            if array.dtype != dtype or array.shape != (*rows, *shape):
                raise UserError(
                    f"Expected the array {name} of {np.dtype(dtype)} and shape {(*rows, *shape)}, "
                    f"got {array.dtype} and {array.shape}. Send it so."
                )
        if header.start:
            self._count, self._seeds = header.count, {}
            self._agent.start(header.count)
        self._arrays, episodes = arrays, arrays["episodes"].tolist()
        self._rows = {episode: row for row, episode in enumerate(episodes)}
        if (
            len(self._rows) < max(1, len(episodes))
            or not 0 <= min(episodes) <= max(episodes) < self._count
        ):
            raise UserError(
                f"Expected episodes that differ, from 0 to below the {self._count} that were "
                f"started, got {shown(str(episodes))}. Start them first."
            )
        if "episode_seeds" in arrays:
            self._seeds.update(zip(episodes, arrays["episode_seeds"].tolist(), strict=True))
        actions = self._agent.act(self, np.array(episodes, np.intp))
        return {"actions": _sendable(actions, len(episodes), self._interface)}

    def _rows_of(self, name: str, which: Indices) -> Array:
        return self._arrays[name][[self._rows[i] for i in which.tolist()]]

    def observe(self, which: Indices) -> Batch:
        return {key: self._rows_of(name, which) for key, name in self._names.items()}

    def observation(self, i: int) -> Any:
        parts = {key: self._arrays[name][self._rows[i]] for key, name in self._names.items()}
        return parts.get(ALONE, parts)

    def action_masks(self, which: Indices) -> Array:
        return self._rows_of("action_masks", which)

    def agent_seeds(self, which: Indices) -> Array:
        return self._rows_of("seeds", which)

    def agent_seed(self, i: int) -> int:
        if i not in self._seeds:
            raise UserError(f"Expected an episode seed of episode {i}, got none. Send one first.")
        return self._seeds[i]

    def where(self, i: int) -> str:
        return f"a step of episode {i}"


class _ImageSession:
    """A classifier or a detector, as one connection asks it."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def look(self, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what the model tells of an image; raise `UserError` for what is none."""
        image = arrays.get("image", _MISSING)
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise UserError(
                "Expected the array image of uint8 and shape (height, width, 3), got "
                f"{image.dtype} and {image.shape}. Send it so."
            )
        found = self._model.found(image)
        if self._model.task == "classify":
            return {"scores": found.probabilities}
        return {"boxes": found.boxes, "labels": found.classes, "scores": found.scores}


_Sessions = _Session | _ImageSession | None


def _refuse(channel: Channel, error: Exception) -> None:
    """Say what was wrong with a message to a side that speaks some protocol of ours."""
    message = (
        f"Expected messages of protocol {PROTOCOL}, got {error}. Install the same version of "
        "sada_gym on both sides."
    )
    if isinstance(error, OldProtocol):
        channel.refuse_old(message)
    elif isinstance(error, Unexpected | UserError):
        channel.send(_failed(message), {}, channel.deadline())


def _failed(message: str, number: int = 0) -> Failed:
    return Failed(number=number, message=message.encode(errors="backslashreplace").decode())


def _choices(space: Any) -> int:
    return int(load("sada_gym.agents.model_call:mask_size")(space))  # which needs torch


def _sendable(actions: Any, count: int, interface: Interface) -> Array:
    """Return actions as one array of numbers, (count, ...)."""
    shape = (count, *(interface.action_space.shape or ()))
    try:
        array = np.asarray(actions)
    except (TypeError, ValueError):
        array = np.empty(0, object)
    if array.dtype not in DTYPES.values() or array.shape != shape:
        raise UserError(
            f"Expected actions of shape {shape} from the agent, got {shown(str(actions))}. Fix "
            "what it returns."
        )
    return array
