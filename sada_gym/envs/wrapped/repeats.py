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
) -> list[Trace]:
    """Play worlds of `count` episodes each together, and each alone by the same actions.

    `traced` plays a slice of them by the agent, or by the actions of given traces.

    Raises:
        UserError: If an episode goes another way, alone or beside other worlds.
    """
    together = traced(slice(None))
    for i, seed in enumerate(seeds):
        own = slice(i * count, (i + 1) * count)
        first, second = (traced(slice(i, i + 1), together[own]) for _ in range(2))
        if told := _difference(first, second):
            raise UserError(
                f"Expected episodes of {name} that follow from their seed, but the world of "
                f"seed {seed} went differently when the same actions were played again. The "
                "environment is random, and not the agent: let it draw from its own np_random "
                "and not from numpy.random or random, and let its episodes share nothing. "
                f"The first difference: {told}."
            )
        if told := _difference(together[own], first):
            raise UserError(
                f"Expected episodes of {name} that share nothing, but with the same actions "
                f"the world of seed {seed} went differently among other worlds than alone. "
                "Look for what the class or its module holds, such as a dictionary, a list or a "
                "generator, and make it again in reset; or set num_envs=1, where a process can "
                f"hold one environment only. The first difference: {told}."
            )
    return together


def check_resets(
    name: str, fresh: Sequence[Trace], kept: Sequence[Trace], seeds: list[int], count: int
) -> None:
    """Raise `UserError` if an environment that was reset goes another way than a new one."""
    for i, seed in enumerate(seeds):
        own = slice(i * count, (i + 1) * count)
        if told := _difference(fresh[own], kept[own]):
            raise UserError(
                f"Expected reset of {name} to undo all that earlier episodes did, as reuse=True "
                f"needs, but the world of seed {seed} went differently from a new environment: "
                f"{told}. Make it again in reset, or leave reuse out."
            )


def _difference(some: Sequence[Trace], others: Sequence[Trace]) -> str:
    """Say where episodes first differ; "" where they do not."""
    for one, other in zip(some, others, strict=True):
        for step, (left, right) in enumerate(
            zip(one.observations, other.observations, strict=False)
        ):
            if not same_answer(left, right):
                when = (
                    f"after step {step}" if step else "after its reset, which may ignore the seed"
                )
                return f"{_entry(left, right)} right {when}"
        for step, (left, right) in enumerate(zip(one.rewards, other.rewards, strict=False), 1):
            if not same_answer(left, right):
                return f"the reward of step {step} was {left:g}, then {right:g}"
        if len(one.rewards) != len(other.rewards):
            return f"it ended after {len(one.rewards)} steps, then after {len(other.rewards)}"
    return ""


def _entry(one: Any, other: Any, name: str = "observation") -> str:
    """Name the first entry in which two observations differ, and its values."""
    if isinstance(one, dict | tuple) and type(one) is type(other) and len(one) == len(other):
        keys = one if isinstance(one, dict) else range(len(one))
        return next(
            _entry(one[key], other[key], f"{name}[{key!r}]")
            for key in keys
            if not same_answer(one[key], other[key])
        )
    left, right = np.asarray(one), np.asarray(other)
    if left.shape != right.shape:
        return f"the {name} had shape {left.shape}, then {right.shape}"
    if left.shape:
        differing = np.argwhere(~((left == right) | ((left != left) & (right != right))))
        i = tuple(differing[0].tolist()) if len(differing) else (0,) * left.ndim  # 0.0 and -0.0
        name, left, right = f"{name}{[*i]}", left[i], right[i]
    return f"{name} was {left}, then {right}"
