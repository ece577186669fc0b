"""The contract of frozen agents: detectors, classifiers, drivers and pilots alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.identity import identity
from sada_gym.errors import UserError

Indices = npt.NDArray[np.intp]
Task = Literal["classify", "detect"]
"""What a model does that looks at images."""

EpisodesT = TypeVar("EpisodesT", contravariant=True)
ActionsT = TypeVar("ActionsT", covariant=True)


@dataclass(frozen=True)
class Interface:
    """What an agent sees and does in a task; `task_id` is for messages.

    `wrapped_by` holds Gymnasium's kinds of wrappers that are already at work in the task itself;
    `has_masks` says whether it has `action_masks()`.
    """

    task_id: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    wrapped_by: tuple[type[Any], ...] = ()
    has_masks: bool = False


@runtime_checkable
class Agent(Protocol[EpisodesT, ActionsT]):
    """Acts in many episodes in lockstep, in each as if it were alone.

    In a closed loop the episodes are `Episodes` of the application, and an action is an array. For
    a detector or a classifier an episode is one image, and an action is its answer.

    An agent may also have `settings`, a dictionary that JSON can hold: how it is used, as far as an
    action depends on it. Evaluation stores keep them with the name of an agent that has one.
    """

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over what the agent's actions depend on, None where it is unknown."""

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""

    def act(self, episodes: EpisodesT, which: Indices) -> ActionsT:
        """Choose the actions in some of the episodes, in the order of `which`."""
        ...


def identity_of(agent: Agent[Any, Any], given: Any, agent_id: str | None) -> str | None:
    """Return the name by which stores know an agent of the object `given`, see `identity`."""
    return identity(agent.fingerprint, given, agent_id, getattr(agent, "settings", None))


def as_agent(given: Any, policy: Callable[[Any], Agent[Any, Any]], kinds: str) -> Agent[Any, Any]:
    """Return an agent as it is, or the one that `policy` makes of a model with `predict`.

    `kinds` says what the application takes besides agents, for messages.

    Raises:
        UserError: If the object is neither; and what `policy` raises.
    """
    if isinstance(given, Agent):
        return given
    if hasattr(given, "predict"):
        return policy(given)
    lacking = [name for name in ("fingerprint", "start", "act") if not hasattr(given, name)]
    raise UserError(
        f"Expected {kinds}, or an object with fingerprint, start(count) and act(episodes, which), "
        f"got {type(given).__name__}, which has no {' and no '.join(lacking)}. Add what is missing."
    )
