"""Serves an agent to attacks in other processes: `sada_gym.serve(agent)`."""

from __future__ import annotations

import os
import socket
import sys
import threading
from collections.abc import Mapping
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym
import numpy as np

from sada_gym.agents.agent_files import find_agent_file, load_agent_file
from sada_gym.agents.contract import Agent, Indices, Interface
from sada_gym.agents.given import agent_of
from sada_gym.agents.remote.messages import (
    CONNECT,
    CONNECT_UNIX,
    PROTOCOL,
    Array,
    Channel,
    Message,
    Nonsense,
    array_name,
    space_from_json,
)
from sada_gym.agents.tile import ALONE, Batch, keyed
from sada_gym.errors import UserError, check_integer
from sada_gym.lazy import load

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

PORT = 7788


def serve(
    agent: Any,
    *,
    host: str = "127.0.0.1",
    port: int = PORT,
    name: str | None = None,
    allow_pickle: bool = False,
    vec_normalize: str | Path | VecNormalize | Literal[False] | None = None,
) -> None:
    """Serve an agent to attacks, until it is interrupted.

    An attack that starts the calling program itself, `agent=["python", "serve.py"]`, is served
    alone, and the function returns when the attack ends. Several connections are served in turn.

    Args:
        agent: What `agent=` of `GymnasiumApplication` takes, but for addresses and commands.
        host: The address to listen on. The default is reached from this machine alone; whoever
            reaches another one can use the agent.
        port: The port; 0 takes any that is free.
        name: What stores know the agent by; change it with the agent. By default it is the hash of
            its weights, where they are known.
        allow_pickle: See `GymnasiumApplication`.
        vec_normalize: The same.

    Raises:
        UserError: If the port cannot be listened on, or there is no such file.
    """
    file = find_agent_file(agent) if isinstance(agent, str | Path) else None
    if vec_normalize:
        load_statistics = load("sada_gym.agents.wrappers:load_vec_normalize")
        vec_normalize = load_statistics(vec_normalize, allow_pickle=allow_pickle)
    served = _Served(file or agent, name, allow_pickle, vec_normalize)
    asked_by = os.environ.get(CONNECT)
    if asked_by:
        served.answer(_connected(asked_by, os.environ.get(CONNECT_UNIX)))
        return
    check_integer("port", port, 0, 2**16 - 1)
    try:
        listening = socket.create_server((host, port))
    except OSError as error:
        raise UserError(
            f"Expected to listen on {host}:{port}, got {error}. Choose another port=."
        ) from error
    with listening:
        print(f"Serving at tcp://{host}:{listening.getsockname()[1]}", file=sys.stderr, flush=True)
        try:
            while True:
                connection, _ = listening.accept()
                threading.Thread(target=served.answer, args=(connection,), daemon=True).start()
        except KeyboardInterrupt:
            return


def _connected(address: str, path: str | None) -> socket.socket:
    """Connect to an attack by its Unix socket; by host:port where there is none or it fails."""
    if path and hasattr(socket, "AF_UNIX"):
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.connect(path)
        except OSError:  # such as in a container that has other files
            connection.close()
        else:
            return connection
    host, _, port = address.rpartition(":")
    return socket.create_connection((host, int(port)))


class _Served:
    """The agent that all connections share; they take turns."""

    def __init__(
        self, given: Any, name: str | None, allow_pickle: bool, normalisation: Any
    ) -> None:
        self._given, self._name = given, name
        self._allow_pickle, self._normalisation = allow_pickle, normalisation
        self._turn = threading.Lock()

    def answer(self, connection: socket.socket) -> None:
        """Answer the messages of one connection to its end."""
        session: _Session | None = None
        with closing(Channel(connection)) as channel:
            try:
                while (message := channel.receive()) is not None:
                    header = message[0]
                    try:
                        with self._turn:
                            if header.get("type") == "hello":
                                session, reply, arrays = *self._hello(header), {}
                            elif session is None or header.get("type") != "act":
                                raise Nonsense(f"the type {header.get('type')!r}")
                            else:
                                reply, arrays = {"type": "actions"}, session.act(message)
                    except (UserError, NotImplementedError) as error:
                        reply, arrays = {"type": "error", "message": str(error)}, {}
                    channel.send(reply, arrays)
            except (OSError, Nonsense) as error:
                print(f"A connection was closed: {error}", file=sys.stderr, flush=True)

    def _hello(self, header: Mapping[str, Any]) -> tuple[_Session, dict[str, Any]]:
        if header.get("protocol") != PROTOCOL:
            raise UserError(
                f"Expected protocol {PROTOCOL}, got {header.get('protocol')!r}. Install the same "
                "version of sada_gym on both sides."
            )
        kinds = (gym.ObservationWrapper, gym.ActionWrapper)
        interface = Interface(
            str(header.get("environment")),
            space_from_json(header.get("observation_space")),
            space_from_json(header.get("action_space")),
            tuple(kind for kind in kinds if kind.__name__ in header.get("wrapped_by", [])),
            header.get("action_masks") is True,
        )
        given = self._given
        if isinstance(given, Path):
            given = load_agent_file(
                given,
                interface.observation_space,
                interface.action_space,
                allow_pickle=self._allow_pickle,
                has_statistics=self._normalisation is not None,
            )
        elif isinstance(given, Agent):
            given = deepcopy(given)  # another connection starts other episodes
        agent = agent_of(
            given,
            interface,
            self._name or str(getattr(given, "__name__", type(given).__name__)),
            normalisation=self._normalisation,
            deterministic=header.get("deterministic") is not False,
        )
        return _Session(agent, interface), {
            "type": "hello",
            "protocol": PROTOCOL,
            "name": self._name,
            "fingerprint": agent.fingerprint,
            "rows": 0,  # it makes tiles of one size itself
            "action_masks": interface.has_masks,
        }


class _Session:
    """The episodes of one connection, as an agent needs to see them."""

    finite_only = True

    def __init__(self, agent: Agent[Any, Any], interface: Interface) -> None:
        self._agent, self._interface = agent, interface
        self._header: Mapping[str, Any] = {}
        self._arrays: Mapping[str, Array] = {}
        self._which: Indices = np.empty(0, np.intp)
        self._rows: dict[int, int] = {}
        self._seeds: dict[int, int] = {}
        self._names = {key: array_name(key) for key in keyed(interface.observation_space)}

    def act(self, message: Message) -> dict[str, Array]:
        header, self._arrays = message
        if header is not self._header:
            self._read_header(header)
        if header.get("start") is True:
            seeds = self._arrays.get("episode_seeds", np.zeros(len(self._which), np.uint32))
            self._seeds = dict(zip(self._which.tolist(), seeds.tolist(), strict=True))
            self._agent.start(header["count"])
        actions = self._agent.act(self, self._which)
        return {"actions": _sendable(actions, len(self._which), self._interface)}

    def _read_header(self, header: Mapping[str, Any]) -> None:
        episodes, count = header.get("episodes"), header.get("count")
        missing = [name for name in self._names.values() if name not in self._arrays]
        if not isinstance(episodes, list) or type(count) is not int or missing:
            raise Nonsense(f"no episodes, count or {', '.join(missing)}")
        self._which = np.array(episodes, np.intp)
        self._which.flags.writeable = False  # the next message may have the same header
        self._rows = {episode: row for row, episode in enumerate(episodes)}
        self._header = header

    def observe(self, which: Indices) -> Batch:
        if which is self._which:
            return {key: self._arrays[name] for key, name in self._names.items()}
        rows = [self._rows[i] for i in which.tolist()]
        return {key: self._arrays[name][rows] for key, name in self._names.items()}

    def observation(self, i: int) -> Any:
        parts = {key: self._arrays[name][self._rows[i]] for key, name in self._names.items()}
        return parts.get(ALONE, parts)

    def action_masks(self, which: Indices) -> Array:
        return self._arrays["action_masks"][[self._rows[i] for i in which.tolist()]]

    def agent_seeds(self, which: Indices) -> Array:
        return self._arrays["seeds"][[self._rows[i] for i in which.tolist()]]

    def agent_seed(self, i: int) -> int:
        return self._seeds[i]

    def where(self, i: int) -> str:
        return f"a step of episode {i}"


def _sendable(actions: Any, count: int, interface: Interface) -> Array:
    """Return actions as one array of numbers, (count, ...)."""
    shape = (count, *(interface.action_space.shape or ()))
    try:
        array = np.asarray(actions)
    except (TypeError, ValueError):
        array = np.empty(0, object)
    if array.dtype.kind not in "biuf" or array.shape != shape:
        shown = str(actions)[:100]
        raise UserError(
            f"Expected actions of shape {shape} from the agent, got {shown}. Mend what it returns."
        )
    return array
