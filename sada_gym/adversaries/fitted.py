"""The base class of nearly every adversary: it trains, draws fresh samples, and saves files."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.adversaries.fresh import fresh_rows, row_keys
from sada_gym.adversaries.options import choose_options
from sada_gym.adversaries.query_pool import (
    InducedSet,
    draw_permitted,
    draw_uniform,
    evaluate_uniform,
    select_fooling,
)
from sada_gym.errors import UserError, check_known
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats
from sada_gym.foundations.files import OneLine, Strict, write_file, write_model
from sada_gym.parameters import Mu, Permits, all_can_exist

Arrays = Mapping[str, npt.NDArray[Any]]

NONE_FOOLED = "no point of Omega fooled: learnt from the lowest scores instead"

_RECORD, _ARRAYS = "adversary.json", "adversary.safetensors"


class _Record(Strict):
    """The contents of `adversary.json`: a trained adversary without its arrays."""

    adversary: str
    dimension: int
    options: dict[str, Any]
    flags: tuple[OneLine, ...]
    threshold: float
    before_fit: Mapping[str, Any]  # the generator's state before `fit`
    generator: Mapping[str, Any]  # its state when the adversary was saved


class FittedAdversary(Adversary):
    """An adversary that evaluates points, fits a model to them, and draws from the model.

    A subclass implements `fit` and `draw`, and also `query` if not all of its queries are uniform.
    Saving needs no code: loading fits again, to the same points and from the same state of the
    generator. If fitting is slow, implement `arrays` and `restore` to save the model itself.

    The arguments are those of `Adversary`. `queries` are all points evaluated in training, and
    `threshold` is the oracle's. No sample repeats a query.
    """

    queries: Evaluations
    threshold: float
    _trained = False
    _permits: Permits = staticmethod(all_can_exist)  # of the oracle that it was trained on
    _query_keys: set[bytes]
    _before_fit: Mapping[str, Any]

    def query(self, oracle: Query) -> Evaluations:
        """Spend the oracle's budget; return all evaluated points. By default all are uniform."""
        return evaluate_uniform(oracle.remaining, self.dimension, oracle, self.rng)

    @abstractmethod
    def fit(self, queries: Evaluations) -> None:
        """Learn from all evaluated points; `self.threshold` is set."""

    @abstractmethod
    def draw(self, n: int) -> AnyFloats:
        """Draw about n candidates, at least one, from the learnt model: (m, d) in [-1, 1]."""

    def arrays(self) -> Arrays:
        """Return the learnt model as arrays to save. By default nothing is saved."""
        return {}

    def restore(self, arrays: Arrays) -> None:  # noqa: ARG002 - there are none
        """Restore the model from `arrays`; `self.queries` is set. By default it calls `fit`."""
        self.fit(self.queries)

    def _propose(self, n: int, noise: float) -> AnyFloats:
        drawn = self.draw(n)
        return drawn + noise * self.rng.normal(size=drawn.shape) if noise else drawn

    def _uniform(self, n: int) -> Mu:
        return draw_permitted(
            lambda count: draw_uniform(count, self.dimension, self.rng), n, self._permits
        )

    def _select_fooling(self, queries: Evaluations, size: int = 0) -> InducedSet:
        induced = select_fooling(queries, self.threshold, self.rng, size=size or None)
        if induced.fallback:
            self.flags.append(NONE_FOOLED)
        return induced

    def train(self, oracle: Query) -> None:
        """Spend the oracle's remaining budget to learn the fooling distribution.

        Raises:
            ValueError: If the budget is too small, or a score is not finite.
        """
        self.flags, self.threshold = [], float(oracle.threshold)
        self._permits = oracle.permits
        self._before_fit = self.rng.bit_generator.state
        self._set_queries(self._train(oracle))
        self._trained = True

    def _train(self, oracle: Query) -> Evaluations:
        queries = self.query(oracle)
        self._before_fit = self.rng.bit_generator.state
        self.fit(queries)
        return queries

    def sample(self, n: int) -> Mu:
        """Draw n fresh mu: (n, d) float32 in [-1, 1], no two equal and none a query.

        Raises:
            RuntimeError: If it was neither trained nor loaded.
            ValueError: If n different mu cannot be drawn.
        """
        self._check_trained("sample")
        return self._fresh(n)

    def _fresh(self, n: int) -> Mu:
        return fresh_rows(self._propose, (n, self.dimension), self._query_keys)

    def _set_queries(self, queries: Evaluations) -> None:
        self.queries, self._query_keys = queries, row_keys(queries.mu)

    def _check_trained(self, what: str) -> None:
        if not self._trained:
            raise RuntimeError(f"Expected a trained adversary to {what}; call train or load first.")

    def save(self, folder: Path) -> None:
        """Write `adversary.json` and `adversary.safetensors`; raise `RuntimeError` if untrained."""
        self._check_trained("save")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {**self.arrays(), "omega.mu": self.queries.mu, "omega.score": self.queries.score}
        # safetensors writes the memory as it lies, whatever the strides
        content = save({name: np.asarray(array, order="C") for name, array in arrays.items()})
        write_file(folder / _ARRAYS, content)
        record = _Record(
            adversary=self.name,
            dimension=self.dimension,
            options=self.options.as_dict(),
            flags=tuple(self.flags),
            threshold=self.threshold,
            before_fit=self._before_fit,
            generator=self.rng.bit_generator.state,
        )
        write_model(folder / _RECORD, record)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read an adversary that `save` wrote. Its samples go on where the saved one stopped.

        Raises:
            ValueError: If the folder holds no such adversary, or a number in it is not finite.
        """
        try:
            return cls._loaded(Path(folder))
        except (OSError, KeyError, TypeError, ValueError, RuntimeError, SafetensorError) as error:
            raise UserError(
                f"Expected a folder that `{cls.__name__}.save` wrote, got {folder}: "
                f"{_in_a_line(error)}"
            ) from error

    @classmethod
    def _loaded(cls, folder: Path) -> Self:
        record = _Record.model_validate_json((folder / _RECORD).read_bytes())
        check_known("saved adversary", [record.adversary], [cls.name])
        # options alone: a file must not choose other arguments, such as a path to write to
        options = choose_options(cls.name, cls.options_class(), {}, "default", record.options)
        adversary = cls(record.dimension, seed=0, **options.as_dict())
        adversary.threshold = record.threshold
        arrays = load((folder / _ARRAYS).read_bytes())
        for name, array in arrays.items():
            if array.dtype.kind not in "fiu":
                raise UserError(f"{name} holds {array.dtype}, not numbers")
            if not np.isfinite(array).all():
                raise UserError(f"{name} holds NaN or infinite numbers")
        score = validate_array(arrays, "omega.score", None)
        mu = validate_array(arrays, "omega.mu", len(score), adversary.dimension)
        if mu.dtype != np.float32 or score.dtype != np.float64 or (np.abs(mu) > 1.0).any():
            raise UserError("omega.mu is not float32 within [-1, 1], or omega.score not float64")
        adversary._set_queries(Evaluations.unseeded(mu, score))
        adversary._before_fit = record.before_fit
        adversary.rng.bit_generator.state = record.before_fit
        adversary.restore(arrays)
        adversary.rng.bit_generator.state = record.generator
        adversary.flags = list(record.flags)
        adversary._trained = True
        return adversary


def validate_array(arrays: Arrays, name: str, *shape: int | None) -> npt.NDArray[Any]:
    """Return a file's array; raise `UserError` for another shape, where None is any length."""
    if name not in arrays:
        raise UserError(f"the array {name} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(
        wanted not in (None, length) for length, wanted in zip(array.shape, shape, strict=True)
    ):
        expected = ", ".join("any" if length is None else str(length) for length in shape)
        raise UserError(f"{name} has the shape {array.shape}, not ({expected})")
    return array


def without_prefix(arrays: Arrays, prefix: str) -> Arrays:
    """Return the arrays whose names start with a prefix, by the rest of their names."""
    return {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}


def _in_a_line(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        return f"{'.'.join(map(str, first['loc'])) or _RECORD}: {first['msg']}"
    if isinstance(error, KeyError):
        return f"{error} is missing"
    return " ".join(str(error).split())
