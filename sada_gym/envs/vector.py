"""The base of all batched environments: a generator for each, which a reset seeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from sada_gym.envs.checks import checked_num_envs, checked_render_mode
from sada_gym.resets import reset_mask, spread_seeds

Observed = TypeVar("Observed")


class SeededVectorEnv(gym.vector.VectorEnv[Observed, npt.NDArray[Any], npt.NDArray[Any]]):
    """A batch of environments with a generator each, as `SyncVectorEnv` has.

    Args:
        num_envs: Number of environments.
        render_mode: Among those of the class's `metadata`.

    Attributes:
        autoreset_mode: The mode in `metadata`; some clients expect it as an attribute.
    """

    def __init__(self, *, num_envs: int, render_mode: str | None) -> None:
        self.num_envs = checked_num_envs(num_envs)
        self.autoreset_mode: AutoresetMode = self.metadata["autoreset_mode"]
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generators, one for each environment."""
        return tuple(self._generators)

    def _reseeded(
        self, seed: int | Sequence[int | None] | None, options: dict[str, Any] | None
    ) -> Iterator[tuple[int, int | None]]:
        """Seed the generators of the environments to reset, and give these with their seeds."""
        seeds = spread_seeds(seed, self.num_envs)
        for i in reset_mask(options, self.num_envs):
            given = seeds[i]
            if given is not None:
                self._generators[i] = seeding.np_random(given)[0]
            yield i, given
