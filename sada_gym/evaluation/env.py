"""An oracle as a Gymnasium environment, for adversaries that learn by reinforcement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from sada_gym.arrays import shaped
from sada_gym.errors import BudgetExhausted, check_integer
from sada_gym.proposals import MAX_ENVS, Observation, Proposals, proposal_spaces
from sada_gym.resets import check_reset_options, checked_seed, reset_mask, spread_seeds

if TYPE_CHECKING:
    from sada_gym.evaluation.oracle import Oracle


class OracleEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """An oracle as an environment: the action is mu, the reward is -Q, a step costs one query.

    ## Description
    It shows algorithms that learn from environments what an adversary may see of an application.
    Each step is one query of the oracle, counted against its budget. The step that spends the last
    query ends its episode (`truncated`). Any step after that raises `BudgetExhausted`, before
    anything is evaluated. So the exception ends a training that asks for too many steps, with
    exactly the budget spent, also in the middle of a rollout:

        env = OracleEnv(oracle)
        model = PPO("MlpPolicy", env, n_steps=100)
        with suppress(BudgetExhausted):
            model.learn(oracle.remaining)

    The algorithm then loses what it collected since its last update (`oracle.record` has it), so
    let the length of a rollout divide the budget.

    ## Action Space
    `Box(-1, 1, (d,), float32)`: mu.

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`, as in the adversary's environments: the last mu, the last score
    (clipped to the box), and the share of the episode's steps that is left. The first two are 0
    before the first step.

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The seed of `reset` changes nothing: a query's evaluation seed follows from its
    number, so that a score of a noisy application cannot be asked for again.

    ## Episode End
    Terminated after `horizon` proposals, truncated when the budget is spent before that.

    ## Arguments
    - `oracle`: the oracle to query. It is left open.
    - `horizon=1`: proposals in one episode.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, oracle: Oracle, horizon: int = 1) -> None:
        self.oracle = oracle
        self._proposals = Proposals(oracle.dimension, horizon, count=1)
        self.action_space, self.observation_space = proposal_spaces(oracle.dimension)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; it costs no query."""
        check_reset_options(options)
        super().reset(seed=checked_seed(seed))
        self._proposals.start(0)
        return self._proposals.observation[0].copy(), {}

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Query one mu of shape (d,).

        Raises:
            BudgetExhausted: If no query is left.
        """
        mu = shaped(action, self.action_space.shape, "an action")
        score = float(_query(self.oracle, self._proposals, mu[None])[0])
        terminated = bool(self._proposals.over[0])
        truncated = not terminated and self.oracle.remaining == 0
        info = {"score": score}
        return self._proposals.observation[0].copy(), -score, terminated, truncated, info


class OracleVectorEnv(gym.vector.VectorEnv[Observation, npt.NDArray[Any], npt.NDArray[Any]]):
    """Many `OracleEnv` in lockstep: a step is one call of the oracle and keeps its workers busy.

    Where fewer queries are left than there are environments, a step evaluates the first of its mu,
    as many as are left, and then raises `BudgetExhausted`: the budget is spent to the last query.
    A new episode starts in the step that ends the old one (`AutoresetMode.SAME_STEP`). For
    Stable-Baselines3, wrap it in `sada_gym.sb3.SB3VecEnv`.

    Args:
        oracle: The oracle to query. It is left open.
        num_envs: Number of environments, the queries of a step.
        horizon: Proposals in one episode.

    Attributes:
        autoreset_mode: The mode in `metadata`; some clients expect it as an attribute.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(self, oracle: Oracle, num_envs: int, horizon: int = 1) -> None:
        check_integer("num_envs", num_envs, 1, MAX_ENVS)
        self.num_envs = num_envs
        self.autoreset_mode: AutoresetMode = self.metadata["autoreset_mode"]
        self.oracle = oracle
        self._proposals = Proposals(oracle.dimension, horizon, count=num_envs)
        self.single_action_space, self.single_observation_space = proposal_spaces(oracle.dimension)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes, or those in the boolean array `options["reset_mask"]`."""
        spread_seeds(seed, self.num_envs)
        for i in reset_mask(options, self.num_envs):
            self._proposals.start(i)
        return self._proposals.observation.copy(), {}

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Observation,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Query a batch of mu, (num_envs, d), and start new episodes where old ones ended.

        Raises:
            BudgetExhausted: If fewer queries were left; these are spent then.
        """
        mu = shaped(actions, self.action_space.shape, "actions")
        scores = _query(self.oracle, self._proposals, mu)
        terminated = self._proposals.over
        truncated = ~terminated & (self.oracle.remaining == 0)
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            info: dict[str, Any] = {"score": float(scores[i])}
            if terminated[i] or truncated[i]:
                last = self._proposals.observation[i].copy()
                info = {"final_obs": last, "final_info": info}
                self._proposals.start(i)
            infos = self._add_info(infos, info, i)
        return self._proposals.observation.copy(), -scores, terminated, truncated, infos


def _query(
    oracle: Oracle, proposals: Proposals, batch: npt.NDArray[Any]
) -> npt.NDArray[np.float64]:
    """Take a step of every episode: query a batch of mu, (n, d), as far as the budget goes."""
    proposals.check_begun()
    left = oracle.remaining
    if left < len(batch):
        if left:
            oracle(batch[:left])
        raise BudgetExhausted(
            f"Expected at least {len(batch)} queries to be left for a step, got {left}. The "
            "budget is spent: catch this around the training, as OracleEnv shows."
        )
    scores = oracle(batch)
    proposals.record(batch, scores)
    return scores
