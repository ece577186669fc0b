"""Attributes that follow from others: formulas that are computed once the parameters are set."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.bindings import ParameterBinding
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.feasible import FUNCTIONS, Expression, spelling
from sada_gym.envs.wrapped.paths import held, plain_path, read, write
from sada_gym.errors import InvalidWorld, UserError, UserTypeError, check_known, explained
from sada_gym.foundations.serve_environment import MISSING, mujoco_model, update_model


def is_path(part: ast.AST) -> bool:
    """Say whether a part of an expression names something, such as `model.body_mass[1]`."""
    while isinstance(part, ast.Attribute | ast.Subscript):
        part = part.value
    return isinstance(part, ast.Name)


def overlap(one: str, other: str) -> bool:
    """Say whether one of two paths names the other, or a part of it."""
    short, long = sorted((one, other), key=len)
    return long.startswith(short) and (len(long) == len(short) or long[len(short)] in ".[")


def paths_as_names(tree: ast.expr) -> ast.expr:
    """Return a copy of an expression in which each path is a single name."""

    class Names(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> Any:
            is_name = is_path(node)
            path = plain_path(ast.unparse(node)) if is_name else ""
            return ast.Name(path, ast.Load()) if is_name else super().visit(node)

    named: ast.expr = Names().visit(deepcopy(tree))
    return named


@dataclass(frozen=True)
class Formula(Expression):
    """How an attribute follows from others, such as `masspole * length`.

    Its names are paths of the environment, such as `model.body_mass[1]`, or parameters.
    """

    names: tuple[str, ...] = ()
    role: ClassVar[str] = "derived"
    example: ClassVar[str] = "masspole * length"

    @cached_property
    def _tree(self) -> ast.expr:
        return paths_as_names(self._parsed)

    @cached_property
    def reads(self) -> tuple[str, ...]:
        """The names in it."""
        names = [part.id for part in ast.walk(self._tree) if isinstance(part, ast.Name)]
        return tuple(dict.fromkeys(name for name in names if name not in FUNCTIONS))

    def _check_name(self, name: str) -> None:
        """Leave the names to `Derived`, which knows the environment."""

    def _check_kind(self) -> None:
        """Take any value."""


@dataclass(frozen=True)
class Derived:
    """The formulas of attributes, by their paths, in an order in which each can be computed."""

    formulas: Mapping[str, Formula] = field(default_factory=dict)

    @classmethod
    def given(
        cls,
        given: Mapping[str, str] | None,
        bindings: Mapping[str, ParameterBinding],
        factory: EnvFactory,
        env: gym.Env[Any, Any],
    ) -> Derived:
        """Return what a user means; a `UserError` if an attribute or a name is not there."""
        if given is None:
            return cls()
        if not isinstance(given, Mapping) or not all(
            isinstance(part, str) for item in given.items() for part in item
        ):
            raise UserTypeError(
                "Expected derived to be expressions by attribute, such as {'total_mass': "
                f"'masspole + masscart'}}, got {given!r}."
            )
        world: Any = env.unwrapped
        numbers = [key for key, value in held(world).items() if is_number(value)]
        parameters = {spelling(name) for name in bindings}
        targets = [str(t) for name, binding in bindings.items() for t in binding.targets(name)]
        formulas = {path.strip(): Formula(text) for path, text in given.items()}
        for path, formula in formulas.items():
            taken = [t for t in targets if overlap(plain_path(t), plain_path(path))]
            if taken or path in bindings:
                raise UserError(
                    f"Expected {path!r} either in derived or set by a parameter, got both: "
                    f"{(*taken, path)[0]!r}. Leave one out."
                )
            if not is_numeric(read(world, path)):
                check_known(f"attribute of {factory.name} in derived", [path], numbers)
            for name in formula.reads:
                if name not in parameters and read(world, name) is MISSING:
                    known = [*parameters, *numbers]
                    check_known(f"name in derived {path} = {formula.text!r}", [name], known)
        needs = {
            path: [p for p in formulas for name in formula.reads if overlap(name, plain_path(p))]
            for path, formula in formulas.items()
        }
        try:
            order = [*TopologicalSorter(needs).static_order()]
        except CycleError as error:
            raise UserError(
                "Expected attributes in derived that follow from others, got a circle: "
                f"{' from '.join(error.args[1])}. Express one of them by other attributes."
            ) from error
        return cls({path: formulas[path] for path in order})

    @property
    def settings(self) -> dict[str, str]:
        """The expressions as data for JSON."""
        return {path: formula.text for path, formula in self.formulas.items()}

    def apply(self, env: Any, values: Mapping[str, Any], *, after_reset: bool) -> None:
        """Set the attributes of an unwrapped environment whose parameters are set."""
        spelt = {**{spelling(name): value for name, value in values.items()}, **values}
        for path, formula in self.formulas.items():
            found = {name: read(env, name) for name in formula.reads}
            # attributes first: a factor may have the name of what it multiplies
            named = {k: spelt.get(k, MISSING) if v is MISSING else v for k, v in found.items()}
            if any(value is MISSING for value in named.values()) and not after_reset:
                continue
            what = f"Expected derived {path} = {formula.text!r} to give a number"
            with explained(what, "Narrow the ranges.", InvalidWorld):
                value = formula.value(named)
                if not is_numeric(value) or not np.all(np.isfinite(value)):
                    raise ValueError(f"{value!r} for {dict(values)}")
                current = read(env, path)
                whole = isinstance(current, int) and float(value).is_integer()
            write(env, path, int(value) if whole else value, must_exist=after_reset)


def update_mujoco(env: Any) -> None:
    """Let MuJoCo compute again what follows from its model, such as the masses of subtrees."""
    with explained("Expected MuJoCo to compute its model", "Narrow the ranges.", InvalidWorld):
        update_model(mujoco_model(env))


def is_numeric(value: Any) -> bool:
    """Say whether a value is a number or an array of them."""
    return is_number(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "iuf")
