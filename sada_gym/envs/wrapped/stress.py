"""Adaptive stress testing: an environment whose action is the disturbance of the next step."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from sada_gym.densities import WorldDensity
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.episodes import EpisodeStart, GymnasiumEpisodes
from sada_gym.envs.wrapped.profiles import Live
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.evaluations import Evaluations, fools
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.determinism import single_threaded
from sada_gym.foundations.seeds import SEED_BOUND, fold_seed
from sada_gym.parameters import ParameterSpace

Actions = Literal["mu", "normal"]

_WIDEST = 5.0
"""Standard deviations that an action may reach."""


class StressEnv(gym.Env[Any, Floats32]):
    """An environment for an adversary that disturbs the agent in each step of an episode.

    ## Description
    A step is one step of the agent. The action says how strong each disturbance is in this step.
    The reward is that of adaptive stress testing (Lee et al. 2015; Koren et al. 2018): the
    likeliest way into a failure has the greatest return.

    ## Action Space
    `Box(-1, 1, (k,), float32)`: mu of each of the k parameters of the application in this step.
    With `actions="normal"` it is `Box(-5, 5, (k,), float32)`: standard normal numbers, which become
    draws from the parameters' density.

    ## Observation Space
    The agent's observation space, or the numbers that `state` returns.

    ## Rewards
    In each step: the logarithm of the disturbances' density minus its greatest value, so at most 0,
    and 0 for parameters without a density. At the end of an episode without a failure: minus `miss`
    times (Q - threshold). `info` holds the parts: `log_likelihood`, and `miss_distance` at the end.

    ## Starting State
    A new world of the application, by its seed.

    ## Episode End
    Terminated when the episode of the agent ends; `info` then has `score`, `fooled`, `seed`,
    `invalid` (why the world broke), and `requirements` if there are several. The attribute
    `failures` keeps the worlds of failures; parameters have usual values after an episode's end.

    ## Arguments
    - `application`: its parameters must be able to change in each step, and must have no knots.
    - `actions="mu"`: what an action means, see Action Space.
    - `state=None`: a function of `env.unwrapped` that returns numbers to observe.
    - `miss=1000.0`: the weight of the distance by which an episode misses a failure.

    The attribute `application` is the same application with a knot for each step. It can evaluate
    and replay the worlds of failures: `application.replay(failures.mu[0], int(failures.seed[0]))`.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        application: GymnasiumApplication,
        *,
        actions: Actions = "mu",
        state: Callable[[Any], npt.ArrayLike] | None = None,
        miss: float = 1000.0,
    ) -> None:
        if not isinstance(application, GymnasiumApplication):
            raise UserTypeError(f"Expected a GymnasiumApplication, got {application!r}.")
        if not application.repeatable:
            raise UserError(
                f"Expected {application.name} to give a world the same score again, but a random "
                "agent or RealTime does not. Leave it out: nobody could replay its failures."
            )
        check_known("actions", [actions], get_args(Actions))
        if isinstance(miss, bool) or not isinstance(miss, int | float) or not 0 < miss < np.inf:
            raise UserError(f"Expected miss above 0, got {miss!r}.")
        self.application = application.stepwise()
        with suppress(TypeError):  # of what has a lock; only what can be copied has a memory
            self.application.policy = deepcopy(application.policy)
        self._limit = application.step_limit or 0
        self._space: ParameterSpace = application.parameters
        density = application.density
        self._density = WorldDensity(self._space, {}) if density is None else density
        self._highest = self._density.highest
        self._actions, self._state, self._miss = actions, state, float(miss)
        self._width = 1.0 if actions == "mu" else _WIDEST
        shape = (len(self._space),)
        self.action_space = spaces.Box(-self._width, self._width, shape, np.float32)
        self._episodes: GymnasiumEpisodes | None = None
        self._found: list[tuple[Floats32, float, int]] = []
        self.observation_space = application.episode_spec.observation_space
        if state is not None:
            self._begin(0, self._quiet)
            seen = np.shape(self._observed())
            self.observation_space = spaces.Box(-np.inf, np.inf, seen, np.float64)
            self.close()

    @property
    def failures(self) -> Evaluations:
        """The worlds in which the agent failed so far, in their order: mu, score and seed."""
        if not self._found:
            return Evaluations.empty(len(self.application.parameters))
        mu, score, seed = zip(*self._found, strict=True)
        return Evaluations(np.array(mu), np.array(score), np.array(seed, np.int64))

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; its first disturbances come with the first action."""
        super().reset(seed=seed)
        own = fold_seed(seed) if seed is not None else int(self.np_random.integers(SEED_BOUND))
        self._begin(own, self._quiet)
        if self._running.broken:
            raise UserError(
                f"Expected a world of {self.application.name} that begins, got one in which "
                f"{self._running.broken}."
            )
        # steps that the episode does not reach are as likely as can be
        self._mu = np.repeat(self._quiet[:, None], self._limit, axis=1)
        self._steps = 0
        return self._observed(), {}

    @property
    def _quiet(self) -> Floats32:
        """What disturbs the reset as long as nothing is chosen."""
        nominal = self.application.nominal
        if nominal is not None:
            return np.asarray(nominal[:: self._limit])
        return self._drawn(np.zeros(len(self._space), np.float32))

    def step(self, action: npt.ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Disturb one step of the agent."""
        if self._episodes is None:
            raise ResetNeeded("Call reset() before step().")
        given = np.clip(np.asarray(action, np.float32), -self._width, self._width)
        if given.shape != self.action_space.shape or np.isnan(given).any():
            raise UserError(
                f"Expected an action of {len(self._space)} numbers, one for each parameter, got "
                f"{action!r}."
            )
        mu = given if self._actions == "mu" else self._drawn(given)
        if self._steps == 0:
            self._begin(self._seed, mu)  # what disturbs its reset is known only now
        self._choose(mu)
        before = len(self._running.rewards)
        which = np.zeros(1, np.intp)
        policy = self.application.policy
        with single_threaded():
            if not self._running.ended:
                self._episodes.step(which, policy.act(self._episodes, which))
        self._steps = max(len(self._running.rewards), before + 1)
        self._mu[:, before : self._steps] = mu[:, None]
        likelihood = float(self._density.log_density(mu[None])[0] - self._highest)
        info: dict[str, Any] = {"log_likelihood": likelihood}
        ended = self._running.ended
        reward = likelihood
        if ended:
            missed, told = self._ending()
            info |= told
            reward -= self._miss * missed
        observation = self._observed()
        if ended:
            self.close()
        return observation, reward, ended, False, info

    def _drawn(self, normal: Floats32) -> Floats32:
        """Return what standard normal numbers, (k,), are in mu."""
        return np.asarray(self._density.from_normal(normal[None].astype(np.float64))[0])

    def _ending(self) -> tuple[float, dict[str, Any]]:
        """Keep a failure; return how far a failure was, and what to tell."""
        running, threshold = self._running, self.application.fooling_threshold
        if running.broken:
            score = 0.0 if self.application.episode_spec.on_error == "fooled" else 1.0
        else:
            score = float(running.score)
        fooled = (not running.broken or score == 0.0) and fools(score, threshold)
        if fooled:
            self._found.append((self._mu.reshape(-1).copy(), score, self._seed))
        missed = 0.0 if fooled else score - threshold
        told = {"score": score, "fooled": fooled, "seed": self._seed, "invalid": running.broken}
        if names := self.application.requirements:
            told["requirements"] = dict(running.margins) or dict.fromkeys(names, score)
        return missed, {**told, "miss_distance": missed}

    def _begin(self, seed: int, mu: Floats32) -> None:
        self.close()
        self._seed = seed
        spec = self.application.episode_spec
        highest = self._space.physical(np.ones(len(self._space), np.float32)).tolist()
        self._live = {
            key: Live((binding.value(high),), self._limit)
            for (key, binding), high in zip(spec.bindings.items(), highest, strict=True)
        }
        self._choose(mu)
        with single_threaded():
            self.application.policy.start(1)
            self._episodes = GymnasiumEpisodes(spec, [EpisodeStart(self._live, seed, 0)])
        self._running = self._episodes.running[0]

    def _choose(self, mu: Floats32) -> None:
        values = self._space.physical(mu).tolist()
        bindings = self.application.episode_spec.bindings.items()
        for (key, binding), value in zip(bindings, values, strict=True):
            self._live[key].chosen[:] = [binding.value(value)]

    def _observed(self) -> Any:
        if self._running.observation is not None:
            self._last = self._running.observation
        if self._state is None:
            return self._last
        if self._running.env is not None:
            self._seen = np.array(self._state(self._running.environment.unwrapped), np.float64)
        return self._seen

    def close(self) -> None:
        """Close the agent's environment."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes = None
