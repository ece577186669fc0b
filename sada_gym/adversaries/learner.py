"""What the adversaries share that learn arrays from evaluated points: fresh samples, and files."""

from __future__ import annotations

import json
import zipfile
from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.adversaries import refuse_unknown
from sada_gym.adversaries.base import Adversary, Query
from sada_gym.adversaries.omega import Omega
from sada_gym.errors import UserError

Arrays = Mapping[str, npt.NDArray[Any]]

NONE_FOOLED = "no point of Omega fooled: learnt from the lowest scores instead"

_ARRAYS, _SETTINGS = "adversary.npz", "adversary.json"
_ROUNDS_BEFORE_STIRRING = 100
_STIR = 1e-4


class Learner(Adversary):
    """An adversary whose state is its options, its generator and some arrays.

    A subclass implements `options`, `_train`, `_draw`, `_arrays` and `_restore`.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.

    Attributes:
        omega: All points evaluated in training; no sample repeats one.
        flags: What a reader of the result must know, such as that no point fooled.
    """

    name: ClassVar[str]

    def __init__(self, dimension: int, *, seed: int | None = None) -> None:
        super().__init__(dimension, seed=seed)
        self.omega = Omega(np.zeros((0, dimension), np.float32), np.zeros(0))
        self._trained = False
        self._known: set[bytes] = set()

    @property
    @abstractmethod
    def options(self) -> dict[str, Any]:
        """The keywords that make an equal adversary, JSON-compatible."""

    @abstractmethod
    def _train(self, oracle: Query) -> Omega:
        """Spend the oracle's budget and learn; give all points evaluated."""

    @abstractmethod
    def _draw(self, n: int) -> npt.NDArray[np.floating[Any]]:
        """Draw about n candidates from what was learnt, (m, d) in [-1, 1], at least one."""

    @abstractmethod
    def _arrays(self) -> Arrays:
        """Give what was learnt as arrays; no objects."""

    @abstractmethod
    def _restore(self, arrays: Arrays) -> None:
        """Take back what `_arrays` gave; `omega` is there already."""

    def train(self, oracle: Query) -> None:
        """Spend the oracle's remaining budget to learn the fooling distribution.

        Raises:
            ValueError: If the budget is too small, or a score is not finite.
        """
        self.flags = []
        self._know(self._train(oracle))
        self._trained = True

    def sample(self, n: int) -> npt.NDArray[np.float32]:
        """Draw n fresh mu: (n, d) float32 in [-1, 1], no two equal and none a query.

        Raises:
            RuntimeError: If it was neither trained nor loaded.
        """
        if not self._trained:
            raise RuntimeError("Expected a trained adversary; call train or load first.")

        def propose(missing: int, stir: float) -> npt.NDArray[np.floating[Any]]:
            drawn = self._draw(missing)
            return drawn + stir * self.rng.normal(size=drawn.shape) if stir else drawn

        return fresh_rows(propose, (n, self.dimension), self._known)

    def save(self, folder: Path) -> None:
        """Write arrays and Omega (NPZ), options and the generator's state (JSON).

        Raises:
            RuntimeError: If it was not trained.
        """
        if not self._trained:
            raise RuntimeError("Expected a trained adversary to save; call train first.")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {**self._arrays(), "omega.mu": self.omega.mu, "omega.score": self.omega.score}
        np.savez(folder / _ARRAYS, allow_pickle=False, **arrays)
        settings = {
            "adversary": self.name,
            "dimension": self.dimension,
            "options": self.options,
            "flags": self.flags,
            "generator": self.rng.bit_generator.state,
        }
        (folder / _SETTINGS).write_text(json.dumps(settings, indent=2) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read an adversary that `save` wrote; it samples as the saved one would have gone on.

        Raises:
            ValueError: If the folder holds no such adversary.
        """
        try:
            settings = json.loads((Path(folder) / _SETTINGS).read_text())
            refuse_unknown("saved adversary", [settings["adversary"]], [cls.name])
            adversary = cls(settings["dimension"], seed=0, **settings["options"])
            adversary.flags = [str(flag) for flag in settings["flags"]]
            with np.load(Path(folder) / _ARRAYS, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file}
            adversary._know(Omega(arrays.pop("omega.mu"), arrays.pop("omega.score")))
            adversary._restore(arrays)
            adversary.rng.bit_generator.state = settings["generator"]
        except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
            raise UserError(
                f"Expected a folder that `{cls.__name__}.save` wrote, got {folder}: {error}"
            ) from error
        adversary._trained = True
        return adversary

    def _know(self, omega: Omega) -> None:
        self.omega, self._known = omega, row_keys(omega.mu)


def row_keys(mu: npt.NDArray[np.float32]) -> set[bytes]:
    """Give what tells the rows of mu (n, d) apart."""
    # adding 0 turns -0 into 0: equal rows have equal bytes
    return {row.tobytes() for row in mu + np.float32(0.0)}


def fresh_rows(
    propose: Callable[[int, float], npt.NDArray[np.floating[Any]]],
    shape: tuple[int, int],
    known: set[bytes],
) -> npt.NDArray[np.float32]:
    """Collect rows, no two equal and none known: `shape`, (n, d), float32 in [-1, 1].

    Args:
        propose: Called as propose(missing, stir), gives some rows. Its stir is 0 until few distinct
            ones seem to be left to draw, then a standard deviation to disturb them by.
        shape: n and d.
        known: The `row_keys` of what must not come again.
    """
    chosen: dict[bytes, npt.NDArray[np.float32]] = {}
    rounds = 0
    while len(chosen) < shape[0]:
        stir = _STIR if rounds > _ROUNDS_BEFORE_STIRRING else 0.0
        drawn = np.clip(propose(shape[0] - len(chosen), stir), -1.0, 1.0).astype(np.float32)
        for row in drawn + np.float32(0.0):
            key = row.tobytes()
            if key not in known and len(chosen) < shape[0]:
                chosen.setdefault(key, row)
        rounds += 1
    return np.array(list(chosen.values()), np.float32).reshape(shape)
