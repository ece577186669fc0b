"""Functions as agents, and agents with a memory, one for each episode: one observation a call."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import nullcontext
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np

from sada_gym.agents.contract import Indices
from sada_gym.determinism import generators_kept, one_thread
from sada_gym.errors import UserError, UserTypeError, described, explained


class _OneByOne(ABC):
    """Asks for the action in one episode after another; its name is for messages."""

    fingerprint = None

    def __init__(self, name: str, *, deterministic: bool) -> None:
        self._name, self._deterministic = name, deterministic

    def start(self, count: int) -> None:  # noqa: B027 - functions remember nothing
        """Begin `count` new episodes."""

    def act(self, episodes: Any, which: Indices) -> Any:
        """Return the list of the actions in some episodes, asked for one by one."""
        actions = []
        seeds = None if self._deterministic else episodes.agent_seeds(which)
        with one_thread(), nullcontext() if seeds is None else generators_kept():
            for row, i in enumerate(which.tolist()):
                observation = deepcopy(episodes.observation(i))
                if seeds is not None:
                    from sada_gym.agents.model_call import seed_generators

                    seed_generators(int(seeds[row]))
                try:
                    actions.append(self._ask(episodes, i, observation))
                except UserError:
                    raise
                except Exception as error:  # whatever a user's function may raise
                    raise UserError(
                        f"Expected an action from {self._name} at {episodes.where(i)} for the "
                        f"observation {_short(observation)}, got {described(error)}. "
                        f"{self._called}"
                    ) from error
        return actions

    _called: str

    @abstractmethod
    def _ask(self, episodes: Any, i: int, observation: Any) -> Any:
        """Return the action in episode i."""


class FunctionAgent(_OneByOne):
    """Calls a function with one observation at a time.

    The function must remember nothing: episodes go on in lockstep, so that the next observation is
    that of another episode. Its name is for messages. Unless it is `deterministic`, the global
    generators are seeded for each call.
    """

    _called = "The agent is called as agent(observation), with one observation."

    def __init__(
        self, function: Callable[[Any], Any], name: str, *, deterministic: bool = True
    ) -> None:
        super().__init__(name, deterministic=deterministic)
        self._function = function

    def _ask(self, episodes: Any, i: int, observation: Any) -> Any:  # noqa: ARG002
        return self._function(observation)


class EpisodeAgents(_OneByOne):
    """One agent for each episode, so that it may have a memory.

    Args:
        given: A factory, see `is_factory`, or an agent with `reset`, of which every episode gets a
            copy. The copies share the weights of torch modules.
        name: The agent's name, for messages.
        deterministic: Unless it is, the global generators are seeded for each call.

    A factory and a `reset` that take `seed` get a number that follows from the evaluation's seed.

    Raises:
        UserError: If no agent can be made, or what is made has neither `predict` nor can be called.
    """

    _called = (
        "The agent of an episode is called as agent(observation), or as "
        "agent.predict(observations, deterministic=True) with a batch of one."
    )

    def __init__(self, given: Any, name: str, *, deterministic: bool = True) -> None:
        super().__init__(name, deterministic=deterministic)
        self._given, self._is_factory = given, is_factory(given)
        self._agents: list[Any] = []
        with generators_kept():
            made = self._make(0)
        if not hasattr(made, "predict") and not callable(made):
            raise UserTypeError(
                f"Expected {name} to make an agent, an object with predict or a function of an "
                f"observation, got {made!r}."
            )

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""
        self._agents = [None] * count

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the agents of episodes under way."""
        return {**self.__dict__, "_agents": []}

    def _make(self, seed: int) -> Any:
        with explained(f"Expected an agent for each episode from {self._name}", self._mend):
            if self._is_factory:
                made = _call(self._given, seed)
            else:
                made = deepcopy(self._given, _shared_weights(self._given))
            if callable(reset := getattr(made, "reset", None)):
                _call(reset, seed)
        return made

    @property
    def _mend(self) -> str:
        if self._is_factory:
            return "It is called without arguments, or with seed=."
        return "Pass a function without arguments that makes one."

    def _ask(self, episodes: Any, i: int, observation: Any) -> Any:
        agent = self._agents[i]
        if agent is None:
            agent = self._agents[i] = self._make(episodes.agent_seed(i))
        if not hasattr(agent, "predict"):
            return agent(observation)
        batch: Any
        if isinstance(observation, dict):
            batch = {key: np.asarray(value)[None] for key, value in observation.items()}
        else:
            batch = np.asarray(observation)[None]
        answer = agent.predict(batch, deterministic=self._deterministic)
        actions = np.asarray(answer[0] if isinstance(answer, tuple) else answer)
        if len(actions) != 1:
            raise ValueError(f"{len(actions)} actions for a batch of one observation")
        return actions[0]


def is_factory(given: Any) -> bool:
    """Say whether an object makes agents: a class or function without arguments, or with `seed`."""
    if not (isinstance(given, type) or inspect.isroutine(given) or isinstance(given, partial)):
        return False
    try:
        signature = inspect.signature(given)
    except (TypeError, ValueError):
        return False
    fixed = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = [
        parameter for parameter in signature.parameters.values() if parameter.kind not in fixed
    ]
    required = {parameter.name for parameter in parameters if parameter.default is parameter.empty}
    made_of: Any = given
    while isinstance(made_of, partial):
        made_of = made_of.func
    if isinstance(made_of, type):
        return required <= {"seed"}
    return not signature.parameters or [parameter.name for parameter in parameters] == ["seed"]


def _call(function: Callable[..., Any], seed: int) -> Any:
    try:
        takes_seed = "seed" in inspect.signature(function).parameters
    except (TypeError, ValueError):
        takes_seed = False
    return function(seed=seed) if takes_seed else function()


def _shared_weights(agent: Any) -> dict[int, Any]:
    """Return the memo of a deepcopy that keeps the parameters of an agent's torch modules."""
    import torch

    parts = [agent, *getattr(agent, "__dict__", {}).values()]
    modules = [part for part in parts if isinstance(part, torch.nn.Module)]
    return {id(weight): weight for module in modules for weight in module.parameters()}


def _short(observation: Any) -> str:
    text = repr(observation) if not isinstance(observation, np.ndarray) else str(observation)
    return text if len(text) <= 100 else f"{text[:100]}..."
