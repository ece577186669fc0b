"""Any application as a Gymnasium environment: the action is mu, the reward is -Q."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded

from sada_gym.application import Application, check_declared, isolated_rng
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.evaluation.proposals import Proposals
from sada_gym.foundations.arrays import Floats, Floats32, Indices
from sada_gym.foundations.frames import Frame, as_frame
from sada_gym.foundations.lazy import load
from sada_gym.foundations.lockstep import SAME_STEP, LockstepEnv, LockstepVectorEnv, RenderModes
from sada_gym.foundations.seeds import SEED_BOUND, fold_seed


class AdversaryEnv(LockstepEnv[Floats32]):
    """An environment whose action is a world's mu and whose reward is minus the agent's score.

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
    have seeds below 2**31; `reset` folds a larger one by `sada_gym.foundations.seeds.fold_seed`.

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
        self.application, self.horizon = _made(application, keywords), horizon
        super().__init__(_ScoredProposals(self.application, horizon, 1), render_mode)
        self.metadata = {**self.metadata, "render_fps": self.application.render_fps}

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu, (d,), again; return all frames of the inner episode, and its score."""
        return _replayed(self.application, mu, seed)


class AdversaryVectorEnv(LockstepVectorEnv[Floats32]):
    """Many adversary environments in lockstep: each step calls `Application.evaluate` once.

    It does the same as Gymnasium's `SyncVectorEnv` of `AdversaryEnv` with
    `AutoresetMode.SAME_STEP`, with one exception: an autoreset evaluates nothing, so `render` still
    draws the last evaluation. The arguments are those of `AdversaryEnv`, and `num_envs`.
    """

    metadata: dict[str, Any] = {**AdversaryEnv.metadata, **SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        application: Application | type[Application] | str,
        *,
        num_envs: int = 1,
        horizon: int = 1,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        self.application, self.horizon = _made(application, keywords), horizon
        super().__init__(_ScoredProposals(self.application, horizon, num_envs), render_mode)
        self.metadata = {**self.metadata, "render_fps": self.application.render_fps}

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu, (d,), again, as `AdversaryEnv.replay` does."""
        return _replayed(self.application, mu, seed)


class _ScoredProposals(Proposals):
    """Proposals that an application scores, with the seeds of their evaluations."""

    def __init__(self, application: Application, horizon: int, count: int) -> None:
        super().__init__(len(application.parameters), horizon, count)
        self._application = application
        self._pending: list[int | None] = [None] * count
        self._shown: list[tuple[Floats32, int] | None] = [None] * count

    def fold_seed(self, seed: int) -> int:
        return fold_seed(seed)

    def begin(
        self, i: int, seed: int | None, rng: np.random.Generator, *, autoreset: bool = False
    ) -> None:
        super().begin(i, seed, rng)
        seed = _draw_seed(rng) if seed is None else seed
        self._pending[i] = seed
        if not autoreset:
            self._shown[i] = (np.zeros(len(self._application.parameters), np.float32), seed)

    def _score(
        self, mu: npt.NDArray[Any], generators: Sequence[np.random.Generator]
    ) -> tuple[npt.NDArray[Any], Floats, Sequence[dict[str, Any]]]:
        """Evaluate mu (n, d); a bad one leaves everything as it was."""
        batch = self._application.parameters.validate(mu)
        seeds = [
            _draw_seed(generator) if seed is None else seed
            for seed, generator in zip(self._pending, generators, strict=True)
        ]
        self._pending = [*seeds]  # kept for a second try, should the evaluation raise
        outcomes = self._application.evaluate(batch, seeds)
        self._pending = [None] * len(seeds)
        self._shown = [(row.copy(), seed) for row, seed in zip(batch, seeds, strict=True)]
        return batch, outcomes.score, outcomes.infos

    def render(self, which: Indices) -> list[Frame]:
        frames = []
        for i in which.tolist():
            shown = self._shown[i]
            if shown is None:
                raise ResetNeeded("Expected reset() before render(): there is no world yet.")
            with isolated_rng(self._application):
                drawn = self._application.render(*shown)
            frames.append(as_frame(drawn, f"{type(self._application).__name__}.render"))
        return frames

    def close(self) -> None:
        self._application.close()


def _made(
    application: Application | type[Application] | str, keywords: Mapping[str, Any]
) -> Application:
    named = load(application) if isinstance(application, str) else application
    if isinstance(named, Application):
        if keywords:
            raise UserError(
                f"Expected no keywords with a finished application, got {', '.join(keywords)}. "
                "Pass them to the application, or pass its class."
            )
        check_declared(named)
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
    check_declared(made)
    return made


def _replayed(application: Application, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
    source = f"{type(application).__name__}.replay"
    with isolated_rng(application):
        frames, score = application.replay(mu, seed)
        return [as_frame(frame, source) for frame in frames], score


def _draw_seed(generator: np.random.Generator) -> int:
    return int(generator.integers(SEED_BOUND))
