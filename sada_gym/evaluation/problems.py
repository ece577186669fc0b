"""What can be attacked: an id, a TOML file, an application, or a function."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec, load_env_creator

from sada_gym.application import Application
from sada_gym.errors import UserError, check_known
from sada_gym.foundations.arrays import Floats, real_scores
from sada_gym.foundations.determinism import single_threaded
from sada_gym.foundations.ids import find_spec, names_file, receive_spec, sent_spec
from sada_gym.foundations.lazy import load
from sada_gym.parameters import Mu

BatchFunction = Callable[[Mu], npt.ArrayLike]
"""A user's black box takes (n, d) float32 in [-1, 1] and returns (n,) scores."""

Problem = str | Application | BatchFunction
"""Anything that can be attacked: an id, a TOML file, an application, or (n, d) -> (n,)."""

Scorer = Application | BatchFunction

_READER = "sada_gym.envs.wrapped.toml:read_application"


def make_env(env_id: str, **env_kwargs: Any) -> gym.Env[Any, Any]:
    """Make the adversary environment of a Gymnasium id, unwrapped; `module:ID` imports the module.

    It raises `UserError` if the id or a keyword is unknown, or its `application` is none.
    """
    spec = find_spec(env_id)
    _check_keywords(spec, env_kwargs)
    env = gym.make(spec, disable_env_checker=True, **env_kwargs).unwrapped
    if not isinstance(getattr(env, "application", None), Application):
        env.close()
        raise UserError(
            f"Expected an adversary environment behind {env_id!r}, got {type(env).__name__}. "
            f"To attack an agent in it, write a file that describes both: sada-gym init {env_id}"
        )
    return env


def make_application(env_id: str, **env_kwargs: Any) -> Application:
    """Make the application of an adversary environment, or the one that a TOML file describes.

    Args:
        env_id: An id, see `env_ids` (`module:ID` imports a module that registers the id), or the
            path of a TOML file, see `read_application`.
        **env_kwargs: The environment's keywords; only with an id.

    Raises:
        ValueError: If the id or a keyword is unknown, the id is not one of an adversary
            environment, or the file does not describe an application.
    """
    if not names_file(env_id):
        env: Any = make_env(env_id, **env_kwargs)
        application: Application = env.application
    elif env_kwargs:
        raise UserError(
            f"Expected keywords of an environment only with its id, got {dict(env_kwargs)} with "
            f"{env_id}. Write them into the file."
        )
    else:
        application = load(_READER)(env_id)
    return application


def _check_keywords(spec: EnvSpec, env_kwargs: Mapping[str, Any]) -> None:
    creator = spec.entry_point
    if creator is None:
        raise UserError(f"Expected {spec.id!r} to have an entry point, got none. Register one.")
    accepted = inspect.signature(
        load_env_creator(creator) if isinstance(creator, str) else creator
    ).parameters
    # an AdversaryEnv takes any keywords and checks them itself, by its application's
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values()):
        return
    if env_kwargs.keys() - accepted == {"agent"}:
        raise UserError(
            f"Expected an adversary environment behind {spec.id!r}, got one that takes no agent. "
            f"To attack an agent in it, write a file that describes both: sada-gym init {spec.id} "
            f"--agent {env_kwargs['agent']}"
        )
    check_known(f"keyword of {spec.id}", env_kwargs, list(accepted))


@dataclass(frozen=True)
class Registered:
    """An environment by id and keywords, or a TOML file: small to send, built by the receiver."""

    env_id: str
    env_kwargs: Mapping[str, Any]

    def __getstate__(self) -> dict[str, Any]:
        """Take an id's specification along, as `EnvFactory` does."""
        return {**self.__dict__, "sent": sent_spec(self.env_id)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Register the id."""
        receive_spec(state.pop("sent"))
        self.__dict__.update(state)

    def build(self) -> Application:
        """Build the application."""
        return make_application(self.env_id, **self.env_kwargs)


class Answer(NamedTuple):
    """The scores of n worlds, (n,) finite float64, and why some are invalid, by their place."""

    scores: Floats
    invalid: Mapping[int, str] = {}


def score(scorer: Scorer, mu: Mu, seeds: Sequence[int]) -> Answer:
    """Evaluate one chunk: mu (n, d) float32, valid, and n seeds.

    It raises `UserError` if a user's function returns anything else.
    """
    invalid: Mapping[int, str] = {}
    if isinstance(scorer, Application):
        outcomes = scorer.evaluate(mu, seeds)
        scores, invalid = outcomes.score, outcomes.invalid
    else:
        with single_threaded():
            scores = real_scores(scorer(mu), "the function")
        if scores.shape != (len(mu),):
            raise UserError(
                f"Expected scores of shape ({len(mu)},) from the function for mu of shape "
                f"{mu.shape}, got {scores.shape}. Return one score for each row."
            )
        if not np.isfinite(scores).all():
            row = int(np.flatnonzero(~np.isfinite(scores))[0])
            raise UserError(
                f"Expected finite scores from the function, got {scores[row]} for mu = "
                f"{mu[row].tolist()}. Return 0 where the agent fails altogether."
            )
    return Answer(scores + 0.0, invalid)  # -0.0 becomes 0.0: SQLite would not keep it
