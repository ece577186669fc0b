"""Requirements in signal temporal logic (STL) as scores; rtamt computes their robustness."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.wrapped.factory import code_name
from sada_gym.envs.wrapped.scores import Episode, Score
from sada_gym.errors import (
    InvalidWorld,
    MissingExtra,
    UserError,
    UserTypeError,
    explained,
    install_line,
)
from sada_gym.foundations.arrays import Floats

Signal = int | str | Callable[[Episode], npt.ArrayLike]
"""An entry of the observation by its number, an entry of info by its key, or a function."""

_LOCK = threading.Lock()


@dataclass(frozen=True)
class Requirement(Score):
    """How well an episode keeps a formula: 0.5 where it only just does, 1 and 0 far from there.

    The robustness r says by how much the formula holds (above 0) or is broken. The score is
    0.5 + 0.5 r / (scale + |r|), so that with `fooling_threshold=0.5` the agent fails where r <= 0.
    A step of an episode is a unit of time.

    Attributes:
        formula: In rtamt's syntax, such as `always[0:500] (abs(angle) < 0.2)`.
        signals: Where its variables come from; by default a variable is the entry of info that has
            its name. A function of the episode returns a value at the reset and after each step.
        scale: The robustness that is three quarters of the way to the best score.
    """

    formula: str
    signals: Mapping[str, Signal] = field(default_factory=dict)
    scale: float = 1.0
    keeps_all = True

    def __post_init__(self) -> None:
        """Parse the formula, and check the signals."""
        if not isinstance(self.formula, str) or not isinstance(self.signals, Mapping):
            raise UserTypeError(
                "Expected score=('stl', formula, signals) with a text and a dictionary, got "
                f"{self.formula!r} and {self.signals!r}."
            )
        positive = isinstance(self.scale, int | float) and 0.0 < self.scale < np.inf
        if not positive or isinstance(self.scale, bool):
            raise UserError(f"Expected the scale of an 'stl' score above 0, got {self.scale!r}.")
        for name, where in self.signals.items():
            if isinstance(where, bool) or not (isinstance(where, int | str) or callable(where)):
                raise UserTypeError(
                    f"Expected the signal {name!r} to be the number of an observation's entry, a "
                    f"key of info or a function of the episode, got {where!r}."
                )
        names = _parsed(self.formula)[1]
        if unused := [name for name in self.signals if name not in names]:
            raise UserError(
                f"Expected signals of {self.formula!r}, whose variables are {', '.join(names)}; "
                f"got {unused[0]!r}."
            )

    @property
    def settings(self) -> Any:  # noqa: D102
        signals = {k: code_name(v) if callable(v) else v for k, v in self.signals.items()}
        return ["stl", self.formula, signals, float(self.scale)]

    @property
    def own_functions(self) -> dict[str, Callable[..., Any]]:  # noqa: D102
        return {f"signal {k!r}": v for k, v in self.signals.items() if callable(v)}

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        specification, names = _parsed(self.formula)
        traces = {name: self._trace(name, episode).tolist() for name in names}
        with _LOCK, explained(f"Expected rtamt to judge {self.formula!r}", "Change the formula."):
            told = specification.evaluate({"time": [*range(len(episode) + 1)], **traces})
        robustness = float(told[0][1])
        if np.isinf(robustness):
            return float(robustness > 0.0), False
        return 0.5 + 0.5 * robustness / (self.scale + abs(robustness)), False

    def _trace(self, name: str, episode: Episode) -> Floats:
        where, steps = self.signals.get(name, name), len(episode) + 1
        if callable(where):
            with explained(f"Expected a signal {name!r}", "Fix the function."):
                given: Any = where(episode)
        elif isinstance(where, int):
            given = [_entry(name, observation, where) for observation in episode.observations]
        else:
            given = _of_infos(name, where, episode.infos)
        try:
            values: Floats = np.asarray(given, np.float64).reshape(steps)
        except (TypeError, ValueError) as error:
            raise UserTypeError(
                f"Expected {steps} numbers as the signal {name!r}, one at the reset and one after "
                f"each step, got {given!r:.200}. Pass a function of the episode."
            ) from error
        if not np.isfinite(values).all():
            reason = f"the signal {name!r} is not finite"
            raise InvalidWorld(f"Expected finite signals, but {reason}.", reason)
        return values


def _entry(name: str, observation: Any, index: int) -> Any:
    try:
        return np.ravel(observation)[index]
    except IndexError as error:
        raise UserError(
            f"Expected entry {index} of an observation as the signal {name!r}, got an observation "
            f"of {np.size(observation)} entries."
        ) from error


def _of_infos(name: str, key: str, infos: tuple[Mapping[str, Any], ...]) -> list[Any]:
    first = infos[0] if key in infos[0] else infos[1]  # many say nothing at the reset
    given = [info[key] for info in (first, *infos[1:]) if key in info]
    if len(given) < len(infos):
        listed = ", ".join(repr(str(one)) for one in infos[-1]) or "none"
        raise UserError(
            f"Expected info[{key!r}] at every step as the signal {name!r}, got the keys {listed}. "
            "Name another key, an observation's entry, or pass a function of the episode."
        )
    return given


@lru_cache(maxsize=64)
def _parsed(formula: str) -> tuple[Any, tuple[str, ...]]:
    """Return rtamt's specification, and the names of its variables."""
    try:
        import rtamt
    except ImportError as error:
        raise MissingExtra(
            "Expected rtamt for a score in temporal logic, got none (it needs Python below 3.13). "
            + install_line("stl")
        ) from error
    names: list[str] = []
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # it warns of each variable that it meets
    try:
        while True:
            specification = rtamt.StlDiscreteTimeSpecification()
            for name in names:
                specification.declare_var(name, "float")
            specification.spec = formula
            try:
                specification.parse()
            except KeyError as error:  # a variable that is not declared yet
                names.append(str(error.args[0]))
            else:
                break
    except rtamt.RTAMTException as error:
        raise UserError(
            f"Expected a formula of signal temporal logic, got {formula!r}: {error}. Write it as "
            "rtamt does: always[0:10] (abs(a) < 1 and eventually[0:5] b > 0)."
        ) from error
    finally:
        logging.disable(before)
    return specification, tuple(names)
