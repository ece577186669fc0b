"""The region of worlds that can exist: expressions of the parameters, or functions of them.

Expressions are parsed, never run as Python: only numbers, texts, the parameters, arithmetic,
comparisons and a few functions are known.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from sada_gym.envs.wrapped.factory import code_name, function_name
from sada_gym.errors import UserError, UserTypeError, check_known, explained

Condition = Callable[[Mapping[str, Any]], Any]
"""Takes the parameters' values by name, and returns whether such a world can exist."""

FeasibleLike = str | Condition | Sequence[str | Condition]
"""An expression such as `"mass * gravity < 30"`, a function, or several that must all hold."""

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{function.__name__: function for function in (abs, min, max)},
    **{
        name: getattr(math, name)
        for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan2", "hypot", "floor", "ceil")
    },
}
_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_PARTS = (ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.Call, ast.Name, ast.Constant)
_LONGEST = 1_000


@dataclass(frozen=True)
class Expression:
    """A condition in words of arithmetic, such as `mass * gravity < 30`.

    The names in it are those of the parameters; signs that no name of Python has become `_`. Of
    two that are spelled alike then, it means the one that is spelled so exactly.

    Raises:
        UserError: If it is no such expression, or another name stands in it.
    """

    text: str
    names: tuple[str, ...]
    role: ClassVar[str] = "feasible"
    example: ClassVar[str] = "mass * gravity < 30"

    def __post_init__(self) -> None:
        """Check all its parts."""
        for part in ast.walk(self._tree):
            if isinstance(part, ast.Name) and part.id not in FUNCTIONS:
                self._check_name(part.id)
            elif isinstance(part, ast.Call):
                name = part.func.id if isinstance(part.func, ast.Name) else "?"
                check_known(f"function in {self.role}={self.text!r}", [name], [*FUNCTIONS])
            bad = isinstance(part, ast.expr) and not isinstance(part, _PARTS)
            sign = isinstance(part, ast.operator | ast.unaryop | ast.cmpop)
            if bad or (sign and type(part) not in _OPERATORS) or not _is_plain(part):
                raise UserError(
                    f"Expected arithmetic and comparisons in {self.role}={self.text!r}, got "
                    f"{type(part).__name__}. Pass your own function in Python instead."
                )
        self._check_kind()

    def _check_name(self, name: str) -> None:
        check_known(f"name in feasible={self.text!r}", [name], [*map(spelling, self.names)])
        alike = [other for other in self.names if spelling(other) == name]
        if len(alike) > 1 and name not in alike:
            raise UserError(
                f"Expected one parameter that {name} in feasible={self.text!r} stands for, got "
                f"{' and '.join(alike)}. Rename one of them."
            )

    def _check_kind(self) -> None:
        truth = isinstance(self._tree, ast.Compare | ast.BoolOp)
        if not truth and not isinstance(getattr(self._tree, "op", None), ast.Not):
            raise UserError(f"Expected a comparison, such as {self.example!r}, got {self.text!r}.")

    @cached_property
    def _tree(self) -> ast.expr:
        named: ast.expr = _Knots().visit(self._parsed)
        return named

    @property
    def _parsed(self) -> ast.expr:
        try:
            if len(self.text) > _LONGEST:
                raise ValueError(f"more than {_LONGEST:,} characters")
            return ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise UserError(
                f"Expected an expression such as {self.example!r} as {self.role}, got "
                f"{self.text[:100]!r} ({getattr(error, 'msg', error)})."
            ) from error

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Say whether it holds for the values of the parameters."""
        spelled = {spelling(name): value for name, value in values.items()}
        return bool(self.value({**spelled, **values}))

    def value(self, named: Mapping[str, Any]) -> Any:
        """Compute it from the values of its names."""
        return _value(self._tree, {name: _plain(value) for name, value in named.items()})


class _Knots(ast.NodeTransformer):
    """Takes the parameters of a curve, such as `wind[0]`, as names."""

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        of_name = isinstance(node.value, ast.Name) and isinstance(node.slice, ast.Constant)
        return ast.Name(spelling(ast.unparse(node)), ast.Load()) if of_name else node


def _value(part: ast.expr, named: Mapping[str, Any]) -> Any:
    if isinstance(part, ast.Constant):
        return _plain(part.value)
    if isinstance(part, ast.Name):
        return named[part.id]
    if isinstance(part, ast.UnaryOp):
        return _OPERATORS[type(part.op)](_value(part.operand, named))
    if isinstance(part, ast.BinOp):
        return _OPERATORS[type(part.op)](_value(part.left, named), _value(part.right, named))
    if isinstance(part, ast.BoolOp):
        truths = (bool(_value(value, named)) for value in part.values)
        return all(truths) if isinstance(part.op, ast.And) else any(truths)
    if isinstance(part, ast.Compare):
        ends = [_value(end, named) for end in (part.left, *part.comparators)]
        signs = [_OPERATORS[type(sign)] for sign in part.ops]
        return all(sign(*pair) for sign, pair in zip(signs, pairwise(ends), strict=True))
    assert isinstance(part, ast.Call)
    assert isinstance(part.func, ast.Name)
    return FUNCTIONS[part.func.id](*(_value(argument, named) for argument in part.args))


def _is_plain(part: ast.AST) -> bool:
    if isinstance(part, ast.Call):
        return not part.keywords
    if isinstance(part, ast.Name):
        return isinstance(part.ctx, ast.Load)
    return not isinstance(part, ast.Constant) or isinstance(part.value, bool | int | float | str)


def _plain(value: Any) -> Any:
    # a power of whole numbers could fill the memory
    return float(value) if isinstance(value, int | float | np.number) else value


def spelling(name: str) -> str:
    """Return how a parameter's name is written in an expression."""
    return re.sub(r"\W", "_", unicodedata.normalize("NFKC", name))  # as Python reads names


@dataclass(frozen=True)
class Feasible:
    """Conditions on the parameters' values that must all hold in a world."""

    conditions: tuple[Condition, ...] = ()

    @classmethod
    def of(cls, given: FeasibleLike | None, names: Sequence[str]) -> Feasible:
        """Return what a user means; a UserError if a condition is neither text nor function."""
        if given is None:
            return cls()
        several: Sequence[Any] = given if isinstance(given, tuple | list) else [given]
        conditions: list[Condition] = []
        for condition in several:
            if isinstance(condition, str):
                conditions.append(Expression(condition, tuple(names)))
            elif callable(condition):
                conditions.append(condition)
            else:
                raise UserTypeError(
                    "Expected feasible to be an expression such as 'mass * gravity < 30', a "
                    f"function of the parameters' values, or a list of them, got {condition!r}."
                )
        return cls(tuple(conditions))

    @property
    def settings(self) -> list[str]:
        """The conditions as data for JSON."""
        return [c.text if isinstance(c, Expression) else code_name(c) for c in self.conditions]

    @property
    def functions(self) -> list[Condition]:
        """The conditions that are functions of the user's."""
        return [c for c in self.conditions if not isinstance(c, Expression)]

    def __call__(self, values: Mapping[str, Any]) -> bool:
        """Say whether all conditions hold; a UserError where one cannot tell."""
        for condition in self.conditions:
            what = getattr(condition, "text", None) or function_name(condition)
            with explained(f"Expected feasible={what!r} to judge {dict(values)}"):
                holds = condition(values)
            if not isinstance(holds, bool | np.bool_):
                raise UserTypeError(
                    f"Expected True or False from feasible={what!r}, got {holds!r}."
                )
            if not holds:
                return False
        return True
