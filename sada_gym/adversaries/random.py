"""`random`: uniform mu, the baseline that every other adversary has to beat."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.errors import UserError

_FILE = "random.json"


class Random(Adversary):
    """Samples mu uniformly and learns nothing: its AFR is the share of the box that fools.

    Training spends no query, because none would change a sample.
    """

    name: ClassVar[str] = "random"

    def __init__(self, dimension: int, *, seed: int | None = None) -> None:
        super().__init__(dimension, seed=seed)
        self._trained = False

    def train(self, oracle: Query) -> None:  # noqa: ARG002 - there is nothing to learn
        """Learn nothing; the budget is left as it is."""
        self._trained = True

    def sample(self, n: int) -> npt.NDArray[np.float32]:
        """Draw n uniform mu: (n, d) float32 in [-1, 1].

        Raises:
            RuntimeError: If it was neither trained nor loaded.
        """
        if not self._trained:
            raise RuntimeError("Expected a trained adversary; call train or load first.")
        return self.rng.uniform(-1.0, 1.0, (n, self.dimension)).astype(np.float32)

    def save(self, folder: Path) -> None:
        """Write the dimension and the generator's state."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        state = {"dimension": self.dimension, "generator": self.rng.bit_generator.state}
        (folder / _FILE).write_text(json.dumps(state, indent=2) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            ValueError: If the folder holds no such adversary.
        """
        path = Path(folder) / _FILE
        try:
            state = json.loads(path.read_text())
            adversary = cls(state["dimension"])
            adversary.rng.bit_generator.state = state["generator"]
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise UserError(f"Expected {path} as `Random.save` wrote it, got {error!r}.") from error
        adversary._trained = True
        return adversary
