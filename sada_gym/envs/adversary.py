"""Any application as a Gymnasium environment: the action is mu, the reward is -Q."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from sada_gym.application import SEED_BOUND, Application, Outcomes, fold_seed, refuse_undeclared
from sada_gym.arrays import shaped
from sada_gym.envs.checks import RenderModes, checked_render_mode, warn_without_render_mode
from sada_gym.envs.vector import SeededVectorEnv
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.frames import Frame
from sada_gym.lazy import load
from sada_gym.proposals import Observation, Proposals, proposal_spaces
from sada_gym.resets import check_reset_options, checked_seed, spread_seeds


class AdversaryEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """One adversary proposing worlds to one frozen agent.

    ## Description
    Each step is a whole inner episode: the application builds a world from the action, its frozen
    agent acts in it to the end, and the adversary is rewarded with the negated score.

    ## Action Space
    `Box(-1, 1, (d,), float32)`: mu, the application's normalised semantic parameters. A float64
    action is rounded to float32 once; one outside the box is an error.

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`:

    | index | what | least | greatest |
    | --- | --- | --- | --- |
    | 0 to d - 1 | last mu; 0 where there is none yet | -1 | 1 |
    | d | last score; 0 where there is none yet | 0 | 1 |
    | d + 1 | share of the steps that is left | 0 | 1 |

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s, every other one a
    seed drawn from `np_random`; `info["seed"]` names it. A seed is any int from 0 up. Evaluations
    have seeds below 2**31, so `reset` folds a larger one: `sada_gym.application.fold_seed`.

    `reset` evaluates nothing, so it has no score to tell and its info is empty. It does not name
    the coming seed either: in a batch that would stand beside the score of the evaluation before.

    ## Episode End
    Terminated after `horizon` proposals, never truncated.

    The native batch, `gymnasium.make_vec(id, num_envs=n)`, resets in the same step. Gymnasium's
    `SyncVectorEnv` and `AsyncVectorEnv` reset in the *next* step by default, and so waste every
    second action of a one-step episode: pass `vector_kwargs={"autoreset_mode": "SameStep"}`.

    ## Arguments
    - `application`: the black box under attack: an `Application`, a class of them, or the
      `module:Class` of one, as an id of your own passes it:
      `gymnasium.register("Own-v0", entry_point="sada_gym.envs:AdversaryEnv",
      vector_entry_point="sada_gym.envs:AdversaryVectorEnv",
      kwargs={"application": "own_module:OwnApplication"})`.
    - `horizon=1`: proposals in one episode.
    - `render_mode=None`: `"rgb_array"` makes `render` give a frame of the last evaluation; after
      `reset`, of the world at mu = 0 with the seed that comes next.
    - all others: the application's own, where its class is given.

    ## Version History
    The application's documentation has its own.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": RenderModes(["rgb_array"]),
        "render_fps": Application.render_fps,
    }

    def __init__(
        self,
        application: Application | type[Application] | str,
        *,
        horizon: int = 1,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self.application = _made(application, keywords)
        self.metadata = {**self.metadata, "render_fps": self.application.render_fps}
        self.horizon = horizon
        dimension = len(self.application.parameters)
        self.action_space, self.observation_space = proposal_spaces(dimension)
        self._episodes = _Episodes(self.application, horizon, count=1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode. No evaluation takes place, so the info is empty.

        Args:
            seed: Any int from 0 up. Below 2**31 it is the seed of the first evaluation; a larger
                one means the same as `sada_gym.application.fold_seed(seed)`.
            options: There are none.
        """
        check_reset_options(options)
        seed = _folded(checked_seed(seed))
        super().reset(seed=seed)
        self._episodes.begin(0, _draw_seed(self.np_random) if seed is None else seed)
        return self._episodes.observation[0].copy(), {}

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Evaluate one mu of shape (d,)."""
        mu = shaped(action, self.action_space.shape, "an action")
        (info,) = self._episodes.step(mu[None], [self.np_random]).infos
        terminated = bool(self._episodes.over[0])
        return self._episodes.observation[0].copy(), -info["score"], terminated, False, info

    def render(self) -> Frame | None:
        """Draw the last evaluation, or after `reset` the world at mu = 0."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return self._episodes.render(0)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu of shape (d,) again: all frames of the inner episode, and its score."""
        with self.application.isolated_rng():
            return self.application.replay(mu, seed)

    def close(self) -> None:
        """Free what the application holds; calling it twice is fine."""
        self.application.close()


class AdversaryVectorEnv(SeededVectorEnv[Observation]):
    """Many adversary environments in lockstep: one `Application.evaluate` a step.

    It equals `SyncVectorEnv` of `AdversaryEnv` with `AutoresetMode.SAME_STEP`: where an episode
    ends, its info and last observation stand in `infos["final_info"]` and `infos["final_obs"]`,
    and the observation is the next episode's first. The autoreset evaluates nothing. It differs in
    one thing: an autoreset leaves what `render` draws, the last evaluation, in place.

    Args:
        application: The black box under attack, as `AdversaryEnv` takes it.
        num_envs: Number of environments.
        horizon: Proposals in one episode.
        render_mode: `"rgb_array"` makes `render` give a frame of each environment.
        **keywords: The application's own, where its class is given.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        **AdversaryEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        application: Application | type[Application] | str,
        *,
        num_envs: int = 1,
        horizon: int = 1,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        self.application = _made(application, keywords)
        super().__init__(num_envs=num_envs, render_mode=render_mode)
        self.metadata = {**self.metadata, "render_fps": self.application.render_fps}
        self.horizon = horizon
        dimension = len(self.application.parameters)
        self.single_action_space, self.single_observation_space = proposal_spaces(dimension)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._episodes = _Episodes(self.application, horizon, count=num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes, or those in the boolean array `options["reset_mask"]`.

        Args:
            seed: An int (environment i gets seed + i) or a sequence of one seed an environment;
                from 0 up, see `AdversaryEnv.reset`.
            options: `reset_mask`, (num_envs,) bool, where only some are to be reset.
        """
        seeds = [_folded(given) for given in spread_seeds(seed, self.num_envs)]
        for i, given in self._reseeded(seeds, options):
            self._episodes.begin(i, _draw_seed(self._generators[i]) if given is None else given)
        return self._episodes.observation.copy(), {}

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Observation,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Evaluate a batch of mu, (num_envs, d), and begin anew where an episode is over."""
        mu = shaped(actions, self.action_space.shape, "actions")
        outcomes = self._episodes.step(mu, self._generators)
        terminated = self._episodes.over
        infos: dict[str, Any] = {}
        for i, info in enumerate(outcomes.infos):
            if terminated[i]:
                last = self._episodes.observation[i].copy()
                infos = self._add_info(infos, {"final_obs": last, "final_info": info}, i)
                self._episodes.begin(i, _draw_seed(self._generators[i]), autoreset=True)
            else:
                infos = self._add_info(infos, info, i)
        truncated = np.zeros(self.num_envs, dtype=np.bool_)
        return self._episodes.observation.copy(), -outcomes.score, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Draw each environment's last evaluation, or after `reset` its world at mu = 0."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return tuple(self._episodes.render(i) for i in range(self.num_envs))

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu of shape (d,) again: all frames of the inner episode, and its score."""
        with self.application.isolated_rng():
            return self.application.replay(mu, seed)

    def close_extras(self, **_: Any) -> None:
        """Free what the application holds."""
        if hasattr(self, "application"):  # older Gymnasiums close what was refused, too
            self.application.close()


class _Episodes(Proposals):
    """The meta-episodes of n environments around one application, with their seeds."""

    def __init__(self, application: Application, horizon: int, count: int) -> None:
        super().__init__(len(application.parameters), horizon, count)
        self._application = application
        self._pending: list[int | None] = [None] * count
        self._shown: list[tuple[npt.NDArray[np.float32], int] | None] = [None] * count

    def begin(self, index: int, seed: int, *, autoreset: bool = False) -> None:
        """Begin one episode, whose first evaluation has this seed."""
        self.start(index)
        self._pending[index] = seed
        if not autoreset:
            self._shown[index] = (np.zeros(len(self._application.parameters), np.float32), seed)

    def step(self, mu: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Outcomes:
        """Evaluate mu (n, d); a bad one leaves everything as it was."""
        self.check_begun()
        batch = self._application.parameters.validate(mu)
        seeds = [
            _draw_seed(generator) if seed is None else seed
            for seed, generator in zip(self._pending, generators, strict=True)
        ]
        self._pending = [*seeds]  # kept for a second try, should the evaluation raise
        outcomes = self._application.evaluate(batch, seeds)
        self._pending = [None] * len(seeds)
        self._shown = [(row.copy(), seed) for row, seed in zip(batch, seeds, strict=True)]
        self.record(batch, outcomes.score)
        return outcomes

    def render(self, index: int) -> Frame:
        """Draw the last evaluation of one environment, or the world at mu = 0 after its reset."""
        shown = self._shown[index]
        if shown is None:
            raise ResetNeeded("Expected reset() before render(): there is no world yet.")
        with self._application.isolated_rng():
            return self._application.render(*shown)


def _made(
    application: Application | type[Application] | str, keywords: Mapping[str, Any]
) -> Application:
    """Give the application that an environment is built around, made where it is not yet."""
    named = load(application) if isinstance(application, str) else application
    if isinstance(named, Application):
        if keywords:
            raise UserError(
                f"Expected no keywords beside a made application, got {', '.join(keywords)}. Pass "
                "them to the application, or pass its class."
            )
        refuse_undeclared(named)
        return named
    if not (isinstance(named, type) and issubclass(named, Application)):
        raise UserTypeError(
            "Expected an Application, a subclass of it, or the 'module:Class' of one, got "
            f"{application!r}."
        )
    accepted = inspect.signature(named).parameters
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values()):
        subject = f"{getattr(named, 'name', named.__name__)}-v{named.version}"
        known = [*accepted, "horizon", "render_mode"]
        check_known(f"keyword of {subject}", keywords, known)
    made = named(**keywords)
    refuse_undeclared(made)
    return made


def _folded(seed: int | None) -> int | None:
    return None if seed is None else fold_seed(seed)


def _draw_seed(generator: np.random.Generator) -> int:
    return int(generator.integers(SEED_BOUND))
