"""Tools for adversaries that Stable-Baselines3 trains: a callback and samples of a policy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import TensorBoardOutputFormat
from stable_baselines3.common.utils import set_random_seed

from sada_gym.errors import UserError, check_integer
from sada_gym.evaluation.proposals import proposal_spaces
from sada_gym.evaluations import fools
from sada_gym.foundations.determinism import generators_kept
from sada_gym.foundations.sb3_vec_env import SB3VecEnv

if TYPE_CHECKING:
    from sada_gym.evaluation.oracle import Oracle

__all__ = ["AttackCallback", "SB3VecEnv", "sample_policy"]


class AttackCallback(BaseCallback):
    """Logs a training's queries and their scores to TensorBoard.

    After every `every` queries it writes about these queries: `attack/score` (mean Q),
    `attack/fooling_rate`, `attack/budget_left` (queries), and for each parameter its mean
    `mu_mean/NAME`, standard deviation `mu_sd/NAME` and histogram `mu/NAME`. The step of an entry is
    the number of queries spent. It ends the training when the last query is spent. If a step asks
    for more queries than are left, `BudgetExhausted` ends the training before the last entry.

    Args:
        oracle: The oracle that the training environment (`OracleEnv`, `OracleVectorEnv`) queries.
        every: Number of queries between two entries, at least 1.

    Raises:
        ValueError: If `every` is below 1, or, when the training starts, the model was made without
            `tensorboard_log`.

    Example:
        >>> model = PPO("MlpPolicy", OracleEnv(oracle), tensorboard_log="runs/tensorboard")
        >>> model.learn(oracle.remaining, callback=AttackCallback(oracle))
    """

    def __init__(self, oracle: Oracle, every: int = 100) -> None:
        check_integer("every", every, 1)
        super().__init__()
        self.oracle = oracle
        self.every = every
        self._written = 0

    @property
    def _spent(self) -> int:
        return self.oracle.budget - self.oracle.remaining

    def _on_training_start(self) -> None:
        outputs = self.model.logger.output_formats
        writers = [o.writer for o in outputs if isinstance(o, TensorBoardOutputFormat)]
        if not writers:
            raise UserError(
                "Expected a model that writes to TensorBoard, got one that does not. Make it with "
                "tensorboard_log=FOLDER."
            )
        self._writer = writers[0]
        self._written = self._spent

    def _on_step(self) -> bool:
        if self._spent - self._written >= self.every:
            self._write()
        return self.oracle.remaining > 0 or self._ends_by_itself

    @property
    def _ends_by_itself(self) -> bool:
        """Tells whether `learn` ends after this step; stopping it would lose a full rollout."""
        state = self.locals
        full = "n_rollout_steps" in state and state["n_steps"] + 1 == state["n_rollout_steps"]
        return full and self.num_timesteps >= state["total_timesteps"]

    def _on_training_end(self) -> None:
        self._write()

    def _write(self) -> None:
        record, step = self.oracle.record, self._spent
        mu, score = record.mu[self._written :], record.score[self._written :]
        if not len(score):
            return
        self._written = step
        self._writer.add_scalar("attack/score", score.mean(), step)
        self._writer.add_scalar(
            "attack/fooling_rate", fools(score, self.oracle.threshold).mean(), step
        )
        self._writer.add_scalar("attack/budget_left", self.oracle.remaining, step)
        application = self.oracle.application  # a function's parameters are numbered
        numbers = map(str, range(mu.shape[1]))
        names = numbers if application is None else application.parameters.names
        for name, column in zip(names, mu.T, strict=True):
            self._writer.add_scalar(f"mu_mean/{name}", column.mean(), step)
            self._writer.add_scalar(f"mu_sd/{name}", column.std(), step)
            self._writer.add_histogram(f"mu/{name}", column, step)
        self._writer.flush()


def sample_policy(
    model: BaseAlgorithm, dimension: int, n: int, *, seed: int
) -> npt.NDArray[np.float32]:
    """Draw n mu from a trained policy: each is the first proposal of an episode.

    A policy trained with gSDE (`use_sde=True`) gets new noise for each mu. A policy trained behind
    `VecNormalize` sees the observation as it did in training, so load it with its environment:
    `PPO.load(file, env=env)`. The policies of TD3 and DDPG are deterministic, so that all n mu are
    the same.

    Args:
        model: A model trained on an environment of this package (an adversary's, `OracleEnv`).
        dimension: d, the number of semantic parameters.
        n: The number of mu.
        seed: Fixes the draws; the global generators stay as they are.

    Returns:
        (n, d) in [-1, 1]. Stable-Baselines3 clips what a policy puts outside of the box.

    Raises:
        ValueError: If the model's spaces are not those of such an environment, or n or the seed
            is negative.
    """
    check_integer("n", n, 0)
    check_integer("seed", seed, 0, 2**32 - 1)
    action, observation = proposal_spaces(dimension)
    for what, space, own in (
        ("observation", observation, model.observation_space),
        ("action", action, model.action_space),
    ):
        if own != space:
            raise UserError(
                f"Expected a policy whose {what} space is {space}, got {own}. Train it on an "
                f"environment of this package with {dimension} parameters."
            )
    if n == 0:
        return np.zeros((0, dimension), np.float32)
    first: Any = np.zeros((n, dimension + 2), np.float32)
    first[:, -1] = 1.0
    normaliser = model.get_vec_normalize_env()
    if normaliser is not None:
        first = normaliser.normalize_obs(first)
    with generators_kept():
        set_random_seed(seed)
        if model.use_sde:  # else all rows would share the noise of the training's last step
            policy: Any = model.policy
            policy.reset_noise(n)
        mu, _ = model.predict(first, deterministic=False)
    return np.asarray(mu, np.float32)
