"""Whether an environment goes the same way when the same actions are played again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.envs.wrapped.episodes import GymnasiumEpisodes
from sada_gym.errors import UserError
from sada_gym.foundations.determinism import same_answer


class Trace(NamedTuple):
    """What an episode showed, and what was done in it."""

    observations: list[Any]
    rewards: list[float]
    actions: list[Any]


def trace(
    policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]],
    episodes: GymnasiumEpisodes,
    given: Sequence[Trace] = (),
) -> list[Trace]:
    """Play episodes by an agent, or by the actions of given ones until these end."""
    policy.start(len(episodes))
    traces = [Trace([deepcopy(e.observation)], e.rewards, []) for e in episodes.running]
    while True:
        which = episodes.under_way()
        if given:
            left = [i for i in which.tolist() if len(traces[i].actions) < len(given[i].actions)]
            which = np.array(left, np.intp)
        if not len(which):
            return traces
        chosen = (
            [given[i].actions[len(traces[i].actions)] for i in which]
            if given
            else policy.act(episodes, which)
        )
        episodes.step(which, chosen)
        for i, action in zip(which.tolist(), chosen, strict=True):
            traces[i].actions.append(action)
            traces[i].observations.append(deepcopy(episodes.observation(i)))


def check_repeats(
    name: str, traced: Callable[..., list[Trace]], seeds: list[int], count: int
) -> None:
    """Play worlds of `count` episodes each together, and each alone by the same actions.

    `traced` plays a slice of them by the agent, or by the actions of given traces.

    Raises:
        UserError: If an episode goes another way, alone or beside other worlds.
    """
    together = traced(slice(None))
    for i, seed in enumerate(seeds):
        own = slice(i * count, (i + 1) * count)
        first, second = (traced(slice(i, i + 1), together[own]) for _ in range(2))
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
                "generator, and make it anew in reset; or set num_envs=1, where a process can hold "
                "one environment only."
            )
