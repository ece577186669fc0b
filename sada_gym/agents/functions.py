"""The agents that a user's own environment takes: models, functions, and factories of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import nullcontext
from copy import deepcopy
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sada_gym.agents.contract import Agent, Indices, Interface
from sada_gym.errors import UserError, UserTypeError, described, explained
from sada_gym.foundations.arrays import copied
from sada_gym.foundations.determinism import generators_kept, one_thread

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize


def agent_of(
    given: Any,
    interface: Interface,
    name: str,
    *,
    normalisation: VecNormalize | Literal[False] | None = None,
    deterministic: bool = True,
) -> Agent[Any, Any]:
    """Return what acts for an object that a user gives as an agent.

    Args:
        given: An `Agent`, which stays as it is; an object with `predict` for batches; a function of
            an observation; or a factory or an object with `reset`, which make one agent an episode.
            A function or a `predict` with an argument `env` is asked for one observation at a time.
        interface: What the agent sees and does.
        name: The agent's name, for messages.
        normalisation: See `Policy`.
        deterministic: Whether the agent takes its best action; otherwise it draws actions, from the
            evaluation's seed.

    Raises:
        UserError: If it is none of these, or not for this environment.
    """
    if is_factory(given):
        return EpisodeAgents(given, name, deterministic=deterministic)
    if isinstance(given, type):
        raise UserTypeError(
            f"Expected an agent, got the class {given.__name__}, which takes arguments. Make one "
            "of it, such as PPO.load('agent.zip')."
        )
    if isinstance(given, Agent):
        return given
    acts = hasattr(given, "predict") or callable(given)
    if acts and callable(getattr(given, "reset", None)):
        return EpisodeAgents(given, name, deterministic=deterministic)
    if hasattr(given, "predict") and not takes(given.predict, "env"):
        from sada_gym.agents.policy import Policy

        return Policy(given, interface, normalisation=normalisation, deterministic=deterministic)
    if acts:
        return FunctionAgent(given, name, deterministic=deterministic)
    raise UserTypeError(
        "Expected an SB3 model, the path of an SB3 zip, an object with `predict`, or a "
        f"function of an observation as the agent, got {given!r}."
    )


class FunctionAgent:
    """Calls a function with one observation at a time.

    The function must remember nothing: episodes go on in lockstep, so that the next observation is
    that of another episode. Its name is for messages. Unless it is `deterministic`, the global
    generators are seeded for each call.
    """

    fingerprint = None
    _called = "The agent is called as agent(observation), with one observation."

    def __init__(self, given: Callable[..., Any], name: str, *, deterministic: bool = True) -> None:
        self._given, self._name, self._deterministic = given, name, deterministic
        self._takes_env = takes(getattr(given, "predict", given), "env")

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""

    def act(self, episodes: Any, which: Indices) -> Any:
        """Return the list of the actions in some episodes, asked for one by one."""
        actions = []
        seeds = None if self._deterministic else episodes.agent_seeds(which)
        with one_thread(), nullcontext() if seeds is None else generators_kept():
            for row, i in enumerate(which.tolist()):
                observation = copied(episodes.observation(i))
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

    def _ask(self, episodes: Any, i: int, observation: Any) -> Any:
        """Return the action in episode i."""
        return self._asked(self._given, episodes, i, observation)

    def _asked(self, agent: Any, episodes: Any, i: int, observation: Any) -> Any:
        if not self._takes_env:
            return agent(observation)
        if not hasattr(episodes, "environment"):
            raise UserError(
                f"Expected {self._name} without an argument env in a separate process, because the "
                "environment is in the attack's. Pass it as agent= there."
            )
        env = episodes.environment(i)
        if not hasattr(agent, "predict"):
            return agent(observation, env=env)
        answer = agent.predict(observation, deterministic=self._deterministic, env=env)
        return answer[0] if isinstance(answer, tuple) else answer


class EpisodeAgents(FunctionAgent):
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
        super().__init__(given, name, deterministic=deterministic)
        self._is_factory = is_factory(given)
        self._agents: list[Any] = []
        with generators_kept():
            made = self._make(0)
        self._takes_env = takes(getattr(made, "predict", made), "env")
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
        fix = "Pass a function without arguments that makes one."
        if self._is_factory:
            fix = "It is called without arguments, or with seed=."
        with explained(f"Expected an agent for each episode from {self._name}", fix):
            if self._is_factory:
                made = _call(self._given, seed)
            else:
                made = deepcopy(self._given, _shared_weights(self._given))
            if callable(reset := getattr(made, "reset", None)):
                _call(reset, seed)
        return made

    def _ask(self, episodes: Any, i: int, observation: Any) -> Any:
        agent = self._agents[i]
        if agent is None:
            agent = self._agents[i] = self._make(episodes.agent_seed(i))
        if self._takes_env or not hasattr(agent, "predict"):
            return self._asked(agent, episodes, i, observation)
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
    starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    named = [
        parameter for parameter in signature.parameters.values() if parameter.kind not in starred
    ]
    made_of: Any = given
    while isinstance(made_of, partial):
        made_of = made_of.func
    if isinstance(made_of, type):
        return {one.name for one in named if one.default is one.empty} <= {"seed"}
    return not signature.parameters or [one.name for one in named] == ["seed"]


def _call(function: Callable[..., Any], seed: int) -> Any:
    return function(seed=seed) if takes(function, "seed") else function()


def takes(function: Any, name: str) -> bool:
    """Say whether a function has an argument of that name; False for what is no function."""
    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def _shared_weights(agent: Any) -> dict[int, Any]:
    """Return the memo of a deepcopy that keeps the parameters of an agent's torch modules."""
    import torch

    parts = [agent, *getattr(agent, "__dict__", {}).values()]
    modules = [part for part in parts if isinstance(part, torch.nn.Module)]
    return {id(weight): weight for module in modules for weight in module.parameters()}


def _short(observation: Any) -> str:
    text = repr(observation) if not isinstance(observation, np.ndarray) else str(observation)
    return text if len(text) <= 100 else f"{text[:100]}..."
