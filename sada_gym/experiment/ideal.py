"""`ideal`: the control that knows the answer, to read the adversaries' figures by."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.errors import UserError
from sada_gym.experiment.names import IDEAL
from sada_gym.parameters import Mu

__all__ = ["IDEAL", "Ideal"]

_FILE = "fooling-set.safetensors"


class Ideal(Adversary):
    """Draws uniformly from a fooling set, (m, d) points, as a perfect adversary would.

    At a point of the fooling set the agent is fooled on at least half of the seeds, not on all, so
    the ideal AFR can be below 1. Coverage is measured with other points.
    """

    packages = ()

    name: ClassVar[str] = IDEAL

    def __init__(self, dimension: int, *, seed: int | None = None, fooling_set: Mu) -> None:
        super().__init__(dimension, seed=seed)
        if fooling_set.ndim != 2 or fooling_set.shape[1] != dimension or not len(fooling_set):
            raise UserError(
                f"Expected a fooling set of shape (m, {dimension}), m >= 1, got "
                f"{fooling_set.shape}."
            )
        self._fooling_set = fooling_set

    def train(self, oracle: Query) -> None:
        """Learn nothing, because the answer is known."""

    def sample(self, n: int) -> Mu:
        """Draw n mu, (n, d), without replacement unless the set has fewer than n points."""
        points = self._fooling_set
        drawn: Mu = points[self.rng.choice(len(points), n, replace=len(points) < n)]
        return drawn

    def save(self, folder: Path) -> None:
        """Write the fooling set and the generator's state."""
        generator = json.dumps(self.rng.bit_generator.state)
        points = np.ascontiguousarray(self._fooling_set)
        save_file({"mu": points}, folder / _FILE, metadata={"generator": generator})

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Load what `save` wrote, with the state of the generator."""
        with safe_open(folder / _FILE, framework="numpy") as file:
            points, generator = file.get_tensor("mu"), file.metadata()["generator"]
        ideal = cls(points.shape[1], fooling_set=points)
        ideal.rng.bit_generator.state = json.loads(generator)
        return ideal
