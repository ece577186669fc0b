"""Whether an environment goes the same way when the same actions are played again."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.envs.wrapped.episodes import GymnasiumEpisodes
from sada_gym.errors import UserError
from sada_gym.foundations.determinism import same_answer


class Traces(NamedTuple):
    """What episodes showed, and what was done in them."""

    seen: list[Any]
    """Of each episode its observations and its rewards."""
    actions: list[list[Any]]


def trace(
    policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]],
    episodes: GymnasiumEpisodes,
    given: list[list[Any]] | None = None,
) -> Traces:
    """Play episodes by an agent, or by given actions until these end."""
    policy.start(len(episodes))
    everyone = range(len(episodes))
    seen: list[Any] = [[deepcopy(episodes.observation(i))] for i in everyone]
    taken: list[list[Any]] = [[] for _ in everyone]
    while True:
        which = episodes.under_way()
        if given is not None:
            left = [i for i in which.tolist() if len(taken[i]) < len(given[i])]
            which = np.array(left, np.intp)
        if not len(which):
            break
        chosen = (
            policy.act(episodes, which)
            if given is None
            else [given[i][len(taken[i])] for i in which]
        )
        episodes.step(which, chosen)
        for i, action in zip(which.tolist(), chosen, strict=True):
            taken[i].append(action)
            seen[i].append(deepcopy(episodes.observation(i)))
    rewards = [[*episode.rewards] for episode in episodes.running]
    return Traces([*zip(seen, rewards, strict=True)], taken)


def check_repeats(name: str, traced: Callable[..., Traces], seeds: list[int], count: int) -> None:
    """Play worlds of `count` episodes each together, and each alone by the same actions.

    `traced` plays a slice of them by the agent, or by given actions, a list an episode.

    Raises:
        UserError: If an episode goes another way, alone or beside other worlds.
    """
    together, actions = traced(slice(None))
    for i, seed in enumerate(seeds):
        own = slice(i * count, (i + 1) * count)
        first, second = (traced(slice(i, i + 1), actions[own]).seen for _ in range(2))
        if not same_answer(first, second):
            raise UserError(
                f"Expected episodes of {name} that follow from their seed, but the world of "
                f"seed {seed} went otherwise when the same actions were played again. The "
                "environment is random, and not the agent: let it draw from its own np_random "
                "and not from numpy.random or random, and let its episodes share nothing."
            )
        if not same_answer(first, together[own]):
            raise UserError(
                f"Expected episodes of {name} that share nothing, but with the same actions "
                f"the world of seed {seed} went otherwise beside other worlds than alone. Look "
                "for what the class or its module holds, such as a dictionary, a list or a "
                "generator, and make it anew in reset."
            )
