"""Requirements in signal temporal logic (STL) as scores; rtamt computes their robustness."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.functions import takes
from sada_gym.envs.wrapped.factory import code_name
from sada_gym.envs.wrapped.scores import Episode, Score
from sada_gym.errors import (
    InvalidWorld,
    MissingExtra,
    UserError,
    UserTypeError,
    broken_world,
    explained,
    install_line,
)
from sada_gym.foundations.arrays import Floats

Signal = int | str | Callable[..., npt.ArrayLike]
"""An entry of the observation by its number, one of info or of a Dict observation by its key, or a
function of the episode or of the environment, see `Requirement`."""

_LOCK = threading.Lock()
_SYNTAX_ERROR = re.compile(
    r".*?(\d+):(\d+): Syntax ERROR, (?:missing (\S+) |.*?)(?:at|input):? '(.*?)'"
    r"(?: expecting (.*?))?\s*",
    re.DOTALL,
)
_NAMES = "Names have the letters a to z; map others by signals={'NAME': where}. "
_HINTS = {
    "refers to undeclared": "Write x_y, and say where it comes from by signals={'x_y': 'x.y'}. ",
    "recognition": f"{_NAMES}For a power write pow(x, 2). ",
    "NoneType": "Give unless a window, such as unless[0:10]. ",
    "expecting {'-', IntegerLiteral, RealLiteral}": "For -x write 0 - x. ",
    "input '['": "Name an array's entry by signals={'x': 'x[0]'}. ",
    "input 's'": "s is a unit of time: use another name, and signals={'x': 's'}. ",
    "input '&'": "Write and. ",
    "input '|'": "Write or. ",
    "input '*'": "For a power write pow(x, 2). ",
}
_EXAMPLE = "An example: always[0:10] (abs(a) < 1 and eventually[0:5] b > 0)."


@dataclass(frozen=True)
class Requirement(Score):
    """How well an episode keeps a formula: 0.5 where it only just does, 1 and 0 far from there.

    The robustness r says by how much the formula holds (above 0) or is broken. The score is
    0.5 + 0.5 r / (scale + |r|), so that with `fooling_threshold=0.5` the agent fails where r <= 0.
    A step of an episode is a unit of time. Windows end with the episode: one that ends before step
    10 passes `always[10:20]` and fails `eventually[10:20]`.

    Attributes:
        formula: In rtamt's syntax, such as `always[0:500] (abs(angle) < 0.2)`.
        signals: Where its variables come from. A number is an entry of the observation. A text is a
            key of info or, where info lacks it, of a Dict observation; "v[2]" is an entry of an
            array there. A function of the episode returns a value at the reset and after each step;
            one whose argument is called `env` gets the unwrapped environment then, and returns one
            value. Other variables are looked up by their own names.
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
                    "key of info or of the observation, or a function of the episode or of env, "
                    f"got {where!r}."
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

    @property
    def probes(self) -> tuple[Callable[..., Any], ...]:  # noqa: D102
        signals = (where for where in self.signals.values() if callable(where))
        return tuple(function for function in signals if takes(function, "env"))

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        specification, names = _parsed(self.formula)
        traces = {name: _Samples(self._trace(name, episode).tolist()) for name in names}
        expected = f"Expected rtamt to judge {self.formula!r}"
        with _LOCK, explained(expected, "Change the formula."):
            try:
                told = specification.evaluate({"time": [*range(len(episode) + 1)], **traces})
                robustness = float(told[0][1])
                if np.isnan(robustness):
                    raise ArithmeticError("its robustness is NaN")
            except (ArithmeticError, ValueError, TypeError) as error:  # such as sqrt(x) of x < 0
                raise broken_world("the formula", error, expected) from error
        if np.isinf(robustness):
            return float(robustness > 0.0), False
        return 0.5 + 0.5 * robustness / (self.scale + abs(robustness)), False

    def _trace(self, name: str, episode: Episode) -> Floats:
        where, steps = self.signals.get(name, name), len(episode) + 1
        given: Any
        if takes(where, "env"):
            given = episode.probed[id(where)]
        elif callable(where):
            with explained(f"Expected a signal {name!r}", "Fix the function."):
                given = where(episode)
        elif isinstance(where, int):
            given = _entries(name, episode.observations, "an observation", where)
        else:
            given = _by_key(name, where, episode)
        try:
            values: Floats = np.asarray(given, np.float64).reshape(steps)
        except (TypeError, ValueError) as error:
            raise UserTypeError(
                f"Expected {steps} numbers as the signal {name!r}, one at the reset and one after "
                f"each step, got {given!r:.200}. Name an entry, such as 'v[2]', or pass a function."
            ) from error
        if not np.isfinite(values).all():
            reason = f"the signal {name!r} is not finite"
            raise InvalidWorld(f"Expected finite signals, but {reason}.", reason)
        return values


class _Samples(list[float]):
    """A list that `+=` leaves as it is: rtamt pads a variable so, which others read then."""

    def __iadd__(self, other: Any) -> list[float]:  # type: ignore[misc,override]
        return [*self, *other]


def _entries(name: str, arrays: Sequence[Any], what: str, index: int) -> list[Any]:
    try:
        return [np.ravel(array)[index] for array in arrays]
    except IndexError as error:
        raise UserError(
            f"Expected entry {index} of {what} as the signal {name!r}, got "
            f"{np.size(arrays[0])} entries."
        ) from error


def _by_key(name: str, key: str, episode: Episode) -> list[Any]:
    """Return what infos hold by a key such as v or v[2], or else what Dict observations hold."""
    infos = episode.infos
    found = None if key in infos[-1] else re.fullmatch(r"(.+)\[(-?\d+)\]", key)
    base, index = (key, None) if found is None else (found[1], int(found[2]))
    first = infos[0] if base in infos[0] else infos[1]  # many say nothing at the reset
    observations = [o if isinstance(o, Mapping) else {} for o in episode.observations]
    for source in ((first, *infos[1:]), observations):
        if all(base in one for one in source):
            given = [one[base] for one in source]
            return given if index is None else _entries(name, given, repr(base), index)
    listed, ours = (
        ", ".join(map(repr, map(str, one))) or "none" for one in (infos[-1], observations[-1])
    )
    raise UserError(
        f"Expected info[{key!r}] at every step as the signal {name!r}, got the keys {listed}, and "
        f"in the observation {ours}. Name another key, an observation's entry, or a function."
    )


@lru_cache(maxsize=64)
def _parsed(formula: str) -> tuple[Any, tuple[str, ...]]:
    """Return rtamt's specification, and the names of its variables."""
    try:
        import rtamt
        from antlr4 import InputStream
    except ImportError as error:
        raise MissingExtra(
            "Expected rtamt for a score in temporal logic, got none (it needs Python below 3.13). "
            + install_line("stl")
        ) from error
    names: list[str] = []
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # it warns of each variable that it meets
    try:
        ast = rtamt.StlDiscreteTimeSpecification().ast
        lexer = ast.antrlLexerType(InputStream(formula))  # one that refuses what it cannot read
        lexer._listeners = [ast.parserErrorListenerType()]
        tokens = [token.text for token in lexer.getAllTokens()]
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
    except Exception as error:  # rtamt raises more than its own
        raise UserError(_syntax_error(formula, str(error))) from error
    finally:
        logging.disable(before)
    _check(formula, specification, tokens, names)
    return specification, tuple(names)


def _syntax_error(formula: str, told: str) -> str:
    """Say what rtamt expected, what came, where, and how to write it."""
    hint = next((hint for sign, hint in _HINTS.items() if sign in told), "") + _EXAMPLE
    found = _SYNTAX_ERROR.fullmatch(told)
    if found is None:
        told = told.removeprefix("RTAMT Exception: ").strip()
        return f"Expected a formula of signal temporal logic, got {formula!r}: {told:.100}. {hint}"
    line, column, missing, got, wanted = found.groups()
    wanted = missing or wanted or "a sign of rtamt's language"
    if "Literal" in wanted:
        wanted = "a variable or a number" if "Identifier" in wanted else "a number"
    wanted = wanted.replace("<EOF>", "an operator or the end")
    place = sum(len(one) + 1 for one in formula.split("\n")[: int(line) - 1]) + int(column) + 1
    came = "its end" if got == "<EOF>" else repr(got)
    return f"Expected {wanted} at character {place} of the formula {formula!r}, got {came}. {hint}"


def _check(formula: str, specification: Any, tokens: list[str], names: list[str]) -> None:
    """Refuse what rtamt parses, but judges otherwise than it reads, or not at all."""
    nodes = [*specification.ast.specs]
    if len(nodes) > 1 or "=" in tokens:
        parts = " and ".join(repr(node.name) for node in nodes)
        raise UserError(
            f"Expected one formula, got {formula!r}, which rtamt reads as {parts}. Join formulas "
            "by and, compare by ==; the functions are abs, sqrt, exp and pow."
        )
    if "time" in names:
        raise UserError(
            f"Expected other names than 'time', which is rtamt's own, in {formula!r}. Use another "
            "name, and say where it comes from: signals={'t': 'time'}."
        )
    for node in nodes:
        nodes += node.children  # all descendants, one after the other
        if not hasattr(node, "begin"):
            continue
        units = [node.begin_unit or node.end_unit or "s", node.end_unit or "s"]
        low, high = (
            bound * specification.ast.U[unit] / specification.ast.U["s"]
            for bound, unit in zip((node.begin, node.end), units, strict=True)
        )
        if (
            bool(node.begin_unit) > bool(node.end_unit)
            or not 0 <= low <= high
            or {low % 1, high % 1} != {0}
        ):
            raise UserError(
                "Expected windows from a whole number of steps, 0 or more, to one that is no "
                f"smaller, such as [0:10], got [{float(low):g}:{float(high):g}] in {formula!r}."
            )
