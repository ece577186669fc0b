"""An oracle as a Gymnasium environment, for adversaries that learn by reinforcement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import BudgetExhausted
from sada_gym.evaluation.proposals import Proposals
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.lockstep import SAME_STEP, LockstepEnv, LockstepVectorEnv, Transition

if TYPE_CHECKING:
    from sada_gym.evaluation.oracle import Oracle


class OracleEnv(LockstepEnv[Floats32]):
    """An oracle as an environment: the action is mu, the reward is -Q, a step costs one query.

    ## Description
    It lets reinforcement learning act as an adversary that sees only what the oracle answers.
    Each step is one query of the oracle, counted against its budget. The step that spends the last
    query ends its episode (`truncated`). Any step after that raises `BudgetExhausted`, before
    anything is evaluated. So the exception ends a training that asks for too many steps when
    exactly the budget is spent, even in the middle of a rollout:

        env = OracleEnv(oracle)
        model = PPO("MlpPolicy", env, n_steps=100)
        with suppress(BudgetExhausted):
            model.learn(oracle.remaining)

    The algorithm then loses the steps since its last update (`oracle.record` has them), so choose
    a length of the rollout that divides the budget.

    ## Action Space
    `Box(-1, 1, (d,), float32)`: mu.

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`, as in the adversary's environments: the last mu, the last score
    (clipped to the box), and the share of the episode's steps that are left. Before the first step,
    mu and score are 0.

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The seed of `reset` has no effect: a query's evaluation seed follows from its
    number, so that nobody can query a world of a noisy application again with the same seed.

    ## Episode End
    Terminated after `horizon` proposals, truncated if the budget is spent before that.

    ## Arguments
    - `oracle`: the oracle to query. It is not closed.
    - `horizon=1`: the number of proposals in an episode.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, oracle: Oracle, horizon: int = 1) -> None:
        self.oracle = oracle
        super().__init__(_Queries(oracle, horizon, 1))


class OracleVectorEnv(LockstepVectorEnv[Floats32]):
    """A vector environment of `OracleEnv`: a step is one call of the oracle, for all its workers.

    If fewer queries are left than there are environments, a step spends them on the first of its
    mu and then raises `BudgetExhausted`, so that the whole budget is spent.
    A new episode starts in the step that ends the old one (`AutoresetMode.SAME_STEP`). For
    Stable-Baselines3, wrap it in `sada_gym.sb3.SB3VecEnv`.

    Args:
        oracle: The oracle to query. It is not closed.
        num_envs: The number of environments, which is the number of queries in a step.
        horizon: The number of proposals in an episode.
    """

    metadata: dict[str, Any] = {**OracleEnv.metadata, **SAME_STEP}  # noqa: RUF012

    def __init__(self, oracle: Oracle, num_envs: int, horizon: int = 1) -> None:
        self.oracle = oracle
        super().__init__(_Queries(oracle, horizon, num_envs))


class _Queries(Proposals):
    """Proposals that an oracle scores."""

    def __init__(self, oracle: Oracle, horizon: int, count: int) -> None:
        super().__init__(oracle.dimension, horizon, count)
        self._oracle = oracle

    def step(
        self, actions: npt.NDArray[Any], generators: Sequence[np.random.Generator]
    ) -> Transition:
        made = super().step(actions, generators)
        return made._replace(truncated=~made.terminated & (self._oracle.remaining == 0))

    def _score(
        self,
        mu: npt.NDArray[Any],
        generators: Sequence[np.random.Generator],  # noqa: ARG002
    ) -> tuple[npt.NDArray[Any], Floats, Sequence[dict[str, Any]]]:
        """Query the oracle; where fewer queries are left, spend these on the first mu and raise."""
        left = self._oracle.remaining
        if left < len(mu):
            if left:
                self._oracle(mu[:left])
            raise BudgetExhausted(
                f"Expected at least {len(mu)} queries to be left for a step, got {left}. The "
                "budget is spent: catch this around the training, as OracleEnv shows."
            )
        score = self._oracle(mu)
        return mu, score, [{"score": value} for value in score.tolist()]
