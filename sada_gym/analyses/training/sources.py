"""Where worlds to train in come from: an adversary, a run, a suite, a diagnosis."""

from __future__ import annotations

import time
import warnings
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from sada_gym import adversaries
from sada_gym.adversaries.base import Adversary
from sada_gym.analyses.mapping import map_samples
from sada_gym.analyses.regression.suite import SUITE_FILE, read_suite
from sada_gym.analyses.training.worlds import WorldSpace
from sada_gym.envs.wrapped.bindings import Attribute
from sada_gym.errors import FileError, StoreInUse, UserError, UserTypeError, check_known
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import RunSettings
from sada_gym.foundations.files import shown
from sada_gym.measures.diagnosis.record import Condition, read_diagnosis
from sada_gym.measures.diagnosis.rules import draw
from sada_gym.parameters import Mu, Parameter, ParameterSpace
from sada_gym.run import Run, load_run
from sada_gym.run.folder import SETTINGS_FILE
from sada_gym.run.run import as_run

DRAWN = 2_000
"""So many worlds are drawn from an adversary or a diagnosis, once; episodes choose among them."""

_WAIT_S, _PAUSE_S = 30.0, 0.1
_SHAPE = ("low", "high", "unit", "choices", "integer", "log")


@runtime_checkable
class Source(Protocol):
    """Worlds to train in."""

    def pool(self, space: WorldSpace) -> Mu:
        """Return the worlds, (n, d), in the parameters of an environment.

        Raises:
            UserError: If they are worlds of other parameters, or there are none.
        """
        ...


def failures(run: Run | str | Path) -> Source:
    """Return a source of the failures among a run's samples and queries, each world once.

    Raises:
        UserError: If the folder holds no finished run, or the run has no failures.
    """
    finished = as_run(run)
    folder, known = finished.folder, finished.samples + _queries(finished)
    fooled = known.fooled(finished.target.fooling_threshold)
    if not fooled.any():
        raise UserError(
            f"Expected a run with failures, got {len(known):,} worlds in {folder}, none of which "
            "fooled the agent. Attack it with a larger budget or another adversary."
        )
    return _OfRun(finished.settings, str(folder), np.unique(known.mu[fooled], axis=0))


def weaknesses(run: Run | str | Path) -> Source:
    """Return a source of worlds in the weaknesses of a run's diagnosis, by their share of failures.

    Raises:
        UserError: If the run has no diagnosis, or the diagnosis has no weaknesses.
    """
    folder = run.folder if isinstance(run, Run) else run
    found = read_diagnosis(folder).weaknesses
    if not found:
        raise UserError(
            f"Expected a diagnosis that names weaknesses in {folder}, got one without. Train on "
            "failures(RUN) instead."
        )
    return _Rules(str(folder), [(weakness.conditions, weakness.share) for weakness in found])


def as_source(given: Any) -> Source:
    """Return the worlds that a user names.

    A run's folder stands for what its adversary learnt, as does an adversary; a suite for its
    failures; an array, (n, d), for itself.

    Raises:
        UserError: If it is none of these, or cannot be read.
    """
    if isinstance(given, Adversary):
        return _Learnt(given, type(given).__name__)
    if isinstance(given, np.ndarray):
        return _Array(given)
    given = given.folder if isinstance(given, Run) else given
    if isinstance(given, Source):
        return given
    if not isinstance(given, str | Path) or not str(given):
        raise UserTypeError(
            "Expected a run's folder, a suite, an Adversary, failures(RUN), weaknesses(RUN) or an "
            f"array of mu as a source of worlds, got {given!r}."
        )
    path = Path(given)
    if path.suffix == ".json" or (path / SUITE_FILE).is_file():
        return _OfSuite(path)
    if not (path / SETTINGS_FILE).is_file():
        raise FileError(
            f"Expected the folder of a run or a suite, got {path}, which holds neither "
            f"{SETTINGS_FILE} nor {SUITE_FILE}. Name what `sada-gym attack` or `sada-gym export` "
            "wrote."
        )
    run = load_run(path)
    kind = adversaries.find(run.settings.experiment.adversary.name)
    adversary = kind.load(run.adversary_folder)
    return _OfRun(run.settings, str(path), _samples(adversary, str(path)))


@dataclass(frozen=True, eq=False)
class _Array:
    mu: npt.NDArray[Any]

    def pool(self, space: WorldSpace) -> Mu:
        mu = space.parameters.validate(self.mu)
        if not len(mu):
            raise UserError("Expected at least one world to train in, got an array without rows.")
        return mu


@dataclass(frozen=True, eq=False)
class _Learnt:
    adversary: Adversary
    name: str

    def pool(self, space: WorldSpace) -> Mu:
        mu = _samples(self.adversary, self.name)
        if mu.shape[1] != len(space.parameters):
            raise UserError(
                f"Expected an adversary of {len(space.parameters)} parameters, got one of "
                f"{mu.shape[1]}: {self.name}. Take one that attacked this environment."
            )
        return mu


@dataclass(frozen=True, eq=False)
class _OfRun:
    """Worlds, (n, d), in the parameters of a run."""

    settings: RunSettings
    place: str
    mu: Mu

    def pool(self, space: WorldSpace) -> Mu:
        key = self.settings.experiment.target.application
        here = _space_of(key.settings)
        if here is None:
            if key.name != space.name or self.mu.shape[1] != len(space.parameters):
                raise UserError(
                    f"Expected a run that attacked {shown(space.name or 'this environment')}, "
                    f"got one of {shown(key.name)} in {self.place}. Name another run."
                )
            return self.mu
        return _mapped(self.mu, here, space, self.place)


@dataclass(frozen=True, eq=False)
class _OfSuite:
    path: Path

    def pool(self, space: WorldSpace) -> Mu:
        path, suite = read_suite(self.path)
        failing = [case.objective == "failure" for case in suite.cases]
        if not any(failing):
            raise UserError(
                f"Expected a suite with failures, got none among {len(failing)} worlds in {path}. "
                "Export it again, or leave it out."
            )
        return _mapped(suite.mu[failing], suite.parameters, space, str(path))


@dataclass(frozen=True, eq=False)
class _Rules:
    run: str
    rules: list[tuple[tuple[Condition, ...], float]]

    def pool(self, space: WorldSpace) -> Mu:
        total = sum(share for _, share in self.rules)
        rng = np.random.default_rng(0)
        parts = []
        for conditions, share in self.rules:
            named = [condition.parameter for condition in conditions]
            check_known(f"parameter of the diagnosis in {self.run}", named, space.parameters.names)
            count = max(1, round(DRAWN * share / total))
            parts.append(draw(conditions, space.parameters, count, rng))
        return np.concatenate(parts)


def _samples(adversary: Adversary, name: str) -> Mu:
    """Draw worlds from a copy, so that the adversary itself goes on as if nobody had asked."""
    try:
        return deepcopy(adversary).sample(DRAWN)
    except RuntimeError as error:
        raise UserError(
            f"Expected a trained adversary, got {name}, which is not. Train it, or name a run's "
            "folder."
        ) from error


def _queries(run: Run) -> Evaluations:
    """Read a run's training queries; wait for other processes that read them just now."""
    end = time.monotonic() + _WAIT_S
    while True:
        try:
            return run.queries or Evaluations.empty(run.samples.mu.shape[1])
        except StoreInUse:
            if time.monotonic() > end:
                raise
            time.sleep(_PAUSE_S)


def _mapped(mu: Mu, here: ParameterSpace, space: WorldSpace, place: str) -> Mu:
    moved, clipped = map_samples(mu, here, space.parameters, place, space.name or "the environment")
    for name, count in clipped.items():
        warnings.warn(
            f"{count} of {len(mu)} worlds of {place} lie outside the range of {name}, and are "
            "moved to its end.",
            stacklevel=2,
        )
    return moved


def _space_of(settings: dict[str, Any]) -> ParameterSpace | None:
    """Return the parameters that a run of a `GymnasiumApplication` had; None for other runs."""
    if not {"parameters", "order"} <= set(settings):
        return None
    return ParameterSpace(*(_parameter(name, settings) for name in settings["order"]))


def _parameter(name: str, settings: dict[str, Any]) -> Parameter:
    binding = settings["parameters"][name]
    known = {key: binding[key] for key in _SHAPE if key in binding}
    return Attribute(**{**known, "choices": tuple(known.get("choices", ()))}).parameter(name)
