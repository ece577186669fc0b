"""The agents that a user's own environment takes: models, functions, factories, other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from sada_gym.agents.contract import Agent, Interface
from sada_gym.agents.functions import EpisodeAgents, FunctionAgent, is_factory
from sada_gym.errors import UserTypeError

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
    if hasattr(given, "predict"):
        from sada_gym.agents.policy import Policy

        return Policy(given, interface, normalisation=normalisation, deterministic=deterministic)
    if callable(given):
        return FunctionAgent(given, name, deterministic=deterministic)
    raise UserTypeError(
        "Expected an SB3 model, the path of an SB3 zip, an object with `predict`, or a "
        f"function of an observation as the agent, got {given!r}."
    )
