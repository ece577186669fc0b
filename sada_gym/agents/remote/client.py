"""An agent in a separate process, asked over a socket."""

from __future__ import annotations

import hashlib
import json
from abc import abstractmethod
from typing import Any

import numpy as np

from sada_gym.agents.contract import Indices, Interface
from sada_gym.agents.remote.messages import (
    ANSWERS,
    Act,
    Actions,
    Header,
    Hello,
    Welcome,
    array_name,
)
from sada_gym.agents.remote.peer import Peer
from sada_gym.agents.remote.places import Address, Program
from sada_gym.agents.remote.spaces import Array, describe
from sada_gym.agents.tile import Batch, keyed, sampled
from sada_gym.errors import AgentLost, UserError
from sada_gym.foundations.files import shown
from sada_gym.foundations.serve_environment import MAX_ARRAY_BYTES, PROTOCOL


class RemotePeer(Peer):
    """An agent of any kind in a separate process, which says at first who it is."""

    role, lost, answers = "agent", AgentLost, ANSWERS
    start_it = "Start the agent's server, sada_gym.serve(agent) or your own program"

    def _first(self) -> Welcome:
        """Connect, and return what the server says; raise `UserError` if nobody is there."""
        try:
            self._welcome = self._connect()
        except AgentLost as error:
            raise UserError(str(error)) from error
        return self._welcome

    def _again(self) -> None:
        """Connect again where there is no connection; another agent there is lost."""
        if self._link is None and self._connect() != self._welcome:
            self._lose(f"not the agent of the first connection, which was {self.name}")

    @abstractmethod
    def _connect(self) -> Welcome:
        """Open a connection, say hello, and return what the server says of its agent."""

    def _greeted(self, hello: Header, arrays: Batch) -> Welcome:
        self._open()
        return self._exchange(hello, arrays, Welcome)[0].model_copy(update={"number": 0})

    @property
    def name(self) -> str:
        """What the server calls the agent, else what its place is called."""
        return self._welcome.name or self.place.name

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over what the server says of the agent's identity, None where it says nothing."""
        told = self._welcome.model_dump(include={"name", "fingerprint"})
        told = {key: value for key, value in told.items() if value}
        if not told:
            return None
        return hashlib.sha256(json.dumps({"remote": told}, sort_keys=True).encode()).hexdigest()


class RemoteAgent(RemotePeer):
    """Sends the observations of episodes to an agent's process, and gets their actions.

    A server that says `rows` always gets so many observations in a message; missing ones are copies
    of the first, with the episode -1. One that says 0 gets any number.

    Args:
        place: Where the process is. Each of our processes has a connection of its own, or starts
            the program itself.
        interface: What the agent sees and does.
        timeout_s: How long to wait for the program's start, and for each whole answer.
        deterministic: Whether it takes its best action; otherwise it gets seeds to draw by.

    Raises:
        UserError: If nobody is there, or the server refuses, or observations cannot be sent.
    """

    wanted = "actions"

    def __init__(
        self,
        place: Address | Program,
        interface: Interface,
        *,
        timeout_s: float,
        deterministic: bool = True,
    ) -> None:
        super().__init__(place, timeout_s)
        self._interface, self._deterministic = interface, deterministic
        self._count, self._starts = 0, False
        self._rows = self._first().rows
        if self._rows > 1 and not self._same_in_every_place():
            self._rows = 1

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""
        self._count, self._starts = count, True

    def act(self, episodes: Any, which: Indices) -> Array:
        """Return the actions in some episodes, (n, ...).

        It raises `AgentLost` if the process died, stalled or answered nonsense, and `UserError` if
        the agent itself raised an error.
        """
        arrays = {array_name(key): value for key, value in episodes.observe(which).items()}
        if self._welcome.action_masks:
            arrays["action_masks"] = episodes.action_masks(which)
        if not self._deterministic:
            arrays["seeds"] = episodes.agent_seeds(which)
        if self._starts:
            starts = [episodes.agent_seed(i) for i in which.tolist()]
            arrays["episode_seeds"] = np.array(starts, np.uint32)
        return self._asked(arrays, which)

    def _asked(self, arrays: Batch, which: Indices) -> Array:
        arrays = {**arrays, "episodes": which.astype(np.int64)}
        row_bytes = sum(value.nbytes for value in arrays.values()) // len(which)
        rows, answers = self._rows or min(len(which), MAX_ARRAY_BYTES // row_bytes), []
        for first in range(0, len(which), rows):
            part = {key: value[first : first + rows] for key, value in arrays.items()}
            real = len(part["episodes"])
            if real < self._rows:
                copied = [*range(real), *[0] * (rows - real)]
                part = {key: value[copied] for key, value in part.items()}
                part["episodes"][real:] = -1
            answers.append(self._asked_at_once(part)[:real])
        return np.concatenate(answers)

    def _asked_at_once(self, arrays: Batch) -> Array:
        if self._link is None and not self._starts:
            self._lose("a new connection in the middle of an episode")
        self._again()
        header = Act(number=0, start=self._starts, count=self._count)
        actions = self._exchange(header, arrays, Actions)[1].get("actions")
        shape = (len(arrays["episodes"]), *(self._interface.action_space.shape or ()))
        if actions is None or actions.shape != shape:
            got = "none" if actions is None else f"shape {actions.shape}"
            self._lose(f"the array actions: shape {shape} was expected, {got} came")
        self._starts = False
        return actions

    def _connect(self) -> Welcome:
        interface, arrays = self._interface, dict[str, Array]()
        hello = Hello(
            number=0,
            protocol=PROTOCOL,
            environment=shown(interface.task_id),
            observation_space=describe(interface.observation_space, "observation_space", arrays),
            action_space=describe(interface.action_space, "action_space", arrays),
            wrapped_by=tuple(kind.__name__ for kind in interface.wrapped_by),
            action_masks=interface.has_masks,
            deterministic=self._deterministic,
        )
        return self._greeted(hello, arrays)

    def _same_in_every_place(self) -> bool:
        """Whether each of a message's observations keeps its action when they are reversed."""
        drawn = sampled(keyed(self._interface.observation_space), self._rows)
        tile = {array_name(key): value for key, value in drawn.items()}
        if self._welcome.action_masks:
            from sada_gym.agents.model_call import mask_size

            size = mask_size(self._interface.action_space)
            tile["action_masks"] = np.ones((self._rows, size), np.bool_)
        tile["seeds"] = tile["episode_seeds"] = np.zeros(self._rows, np.uint32)
        which = np.arange(self._rows)
        answers = []
        for step in (1, -1):
            self.start(self._rows)
            turned = {key: value[::step] for key, value in tile.items()}
            answers.append(self._asked(turned, which)[::step])
        return np.array_equal(answers[0], answers[1], equal_nan=True)
