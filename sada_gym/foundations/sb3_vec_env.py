"""Gymnasium's vector environments as Stable-Baselines3 expects them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices

from sada_gym.errors import UserError


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment with SAME_STEP autoreset as an SB3 `VecEnv`.

    Args:
        env: The vector environment, such as
            `gymnasium.make_vec("SADA-DrivingTask-v0", num_envs=16)`.

    Attributes:
        env: The vector environment.

    Raises:
        ValueError: If the environment has another autoreset mode: SB3 expects the next episode's
            first observation in the step that ends one.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise UserError(
                f"Expected a vector environment with autoreset mode SAME_STEP, got {mode}. Make it "
                "with gymnasium.make_vec of one of this package's ids."
            )
        self.env = env
        self._actions: npt.NDArray[Any] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Any:
        """Begin all episodes, with the seeds that `seed` set."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        observation, infos = self.env.reset(seed=seeds)  # type: ignore[arg-type]
        self.reset_infos = [_row(infos, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keep the actions (n, ...) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step all environments with the actions of `step_async`."""
        assert self._actions is not None
        observation, reward, terminated, truncated, infos = self.env.step(self._actions)
        rows = []
        for i in range(self.num_envs):
            row = _row(infos, i)
            if terminated[i] or truncated[i]:
                last = row.pop("final_info")
                row |= {
                    **last,
                    "terminal_observation": row.pop("final_obs"),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                }
            rows.append(row)
        return observation, np.asarray(reward, np.float32), terminated | truncated, rows

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environment, once for each index."""
        value = getattr(self.env.unwrapped, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise an error, because the environments of a batch share their attributes."""
        raise NotImplementedError(f"Expected no change of {attr_name}: a batch shares it.")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Raise an error, because the environments of a batch are not separate objects."""
        raise NotImplementedError(f"Expected no call of {method_name}: a batch has no single ones.")

    def env_is_wrapped(
        self,
        wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]],  # noqa: ARG002
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """Return False for each index: only the whole batch can be wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Return the frame of each environment."""
        frames: Any = self.env.render()
        return [None] * self.num_envs if frames is None else list(frames)


def _row(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Pick one environment's info. Where not all have a key, Gymnasium's `_key` marks who does."""
    row = {}
    for key, values in infos.items():
        if not key.startswith("_") and (f"_{key}" not in infos or infos[f"_{key}"][i]):
            value = _row(values, i) if isinstance(values, dict) else values[i]
            row[key] = value.item() if isinstance(value, np.generic) else value
    return row
