"""Which attributes a constructor computed from others, so that they keep their old values.

The source of the class says what is computed from what; worlds tell whether it still holds there.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from itertools import chain
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.derived import Formula, is_numeric, is_path, overlap, paths_as_names
from sada_gym.envs.wrapped.feasible import FUNCTIONS
from sada_gym.envs.wrapped.paths import held, plain_path
from sada_gym.envs.wrapped.paths import read as read_path
from sada_gym.errors import UserError
from sada_gym.foundations.serve_environment import MISSING, mujoco_model

_CASTS = ("float", "float32", "float64")
_CONSTRUCTORS = ("__init__", "__post_init__")
_LONGEST = 1_000
"""Characters of a source text; longer ones say only what they read."""


class _Computed(NamedTuple):
    path: str
    reads: frozenset[str]
    text: str
    by_reset: bool


@cache
def _formula(text: str) -> Formula | None:
    try:
        return Formula(text)
    except UserError:
        return None


class _Substitute(ast.NodeTransformer):
    """Puts what names stand for in their place: attributes of `self`, constants and functions."""

    def __init__(self, names: Mapping[str, ast.expr], known: Mapping[str, Any]) -> None:
        self._names, self._known = names, known

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return self._names.get(node.id) or _constant(self._known.get(node.id)) or node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        home = self._known.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if not isinstance(home, ModuleType):
            return self.generic_visit(node)
        known = ast.Name(node.attr, ast.Load()) if node.attr in FUNCTIONS else node
        return _constant(vars(home).get(node.attr)) or known

    def visit_Call(self, node: ast.Call) -> Any:
        is_cast = ast.unparse(node.func).rpartition(".")[2] in _CASTS and len(node.args) == 1
        return self.visit(node.args[0]) if is_cast else self.generic_visit(node)


def _constant(value: Any) -> ast.expr | None:
    if not is_number(value):
        return None
    return ast.Constant(value if isinstance(value, int) else float(value))


@cache
def _computed(kind: Any, root: str) -> tuple[_Computed, ...]:
    """List what a class's constructor and `reset`, and the methods they call, assign at a path."""
    found: dict[_Computed, None] = {}
    left = [(name, name == "reset") for name in (*_CONSTRUCTORS, "reset")]
    for name, by_reset in left:  # which grows
        for home in reversed(kind.__mro__):
            for tree, known in _function(home, name):
                named = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
                left += [call for n in sorted(named) if (call := (n, by_reset)) not in left]
                found |= dict.fromkeys(_assigned(tree, known, root, by_reset))
    return tuple(found)


@cache
def _used(kind: Any) -> frozenset[str]:
    """List the attributes that a class's methods read, but for constructors."""
    methods = [(home, name) for home in kind.__mro__ for name in vars(home)]
    found = [_function(home, name) for home, name in methods if name not in _CONSTRUCTORS]
    nodes = [node for one in found for tree, _ in one for node in ast.walk(tree)]
    loads = [n for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Load)]
    return frozenset(node.attr for node in loads)


def _function(home: Any, name: str) -> list[tuple[ast.FunctionDef, Mapping[str, Any]]]:
    """Return the source and the globals of a method that a class defines; [] if unreadable."""
    method: Any = vars(home).get(name)
    try:
        method = inspect.unwrap(getattr(method, "fget", method))
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(method))).body
    except (OSError, TypeError, ValueError, SyntaxError):  # written in C, or by `exec`
        return []
    is_method = isinstance(tree, ast.FunctionDef) and tree.args.args
    return [(tree, getattr(method, "__globals__", {}))] if is_method else []  # type: ignore[list-item]


def _assigned(
    tree: ast.FunctionDef, known: Mapping[str, Any], root: str, by_reset: bool
) -> Iterator[_Computed]:
    names = {tree.args.args[0].arg: ast.parse(root, mode="eval").body}

    def meant(node: ast.expr) -> ast.expr:
        resolved: ast.expr = _Substitute(names, known).visit(deepcopy(node))
        return resolved

    pairs = [*_pairs(tree)]
    for target, value in pairs:  # a name that an attribute holds as well stands for it
        source = _Substitute({}, {}).visit(deepcopy(value))
        if isinstance(target, ast.Attribute) and isinstance(source, ast.Name):
            names.setdefault(source.id, meant(target))
    attributes, last = {*names}, dict[str, ast.expr]()
    for target, value in pairs:
        path, source = ast.unparse(meant(target)), meant(value)
        if isinstance(value, ast.BinOp) and value.left is target:  # `x += 1`
            source = ast.BinOp(last.get(path, meant(target)), value.op, meant(value.right))
        parts = [n.id for n in ast.walk(paths_as_names(source)) if isinstance(n, ast.Name)]
        text, reads = ast.unparse(source), [name for name in parts if name.startswith("self.")]
        if isinstance(target, ast.Name) and target.id not in attributes:
            short = len(text) <= _LONGEST
            names[target.id] = source if short else ast.Tuple([ast.Name(r) for r in reads])
        elif path != text and path.startswith("self.") and is_path(meant(target)):
            last[path] = source
            own = frozenset(name.removeprefix("self.") for name in reads)
            yield _Computed(plain_path(path[5:]), own, text.replace("self.", ""), by_reset)


def _pairs(tree: ast.FunctionDef) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Iterate over all that is assigned, in the order of the lines."""
    kinds = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Return)
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    me = ast.Name(tree.args.args[0].arg, ast.Load())
    for node in sorted(nodes, key=lambda node: node.lineno):
        if isinstance(node, ast.Return):  # of a property, say
            node = ast.AnnAssign(ast.Attribute(me, tree.name, ast.Store()), me, node.value, 1)
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        if isinstance(node, ast.AugAssign):
            yield node.target, ast.BinOp(node.target, node.op, node.value)
        elif node.value is not None:
            for target in targets:
                parts, values = (getattr(n, "elts", [n]) for n in (target, node.value))
                several = parts != [target] and len(parts) == len(values)
                yield from zip(parts, values if several else [node.value] * len(parts), strict=True)


class Look(NamedTuple):
    """What a world held once: its own attributes, and what a survey reads of it, by path."""

    own: dict[str, Any]
    at: dict[str, Any]


@dataclass(frozen=True)
class Survey:
    """Which attributes may not follow what parameters set at the paths of `targets`.

    `parts` say how they are computed, and `used` which attributes methods read. Worlds are looked
    at one after another, because a process may hold one only.
    """

    targets: tuple[str, ...]
    parts: tuple[_Computed, ...]
    used: frozenset[str]

    @classmethod
    def of(cls, targets: Sequence[str], world: Any) -> Survey:
        """Read the source of an unwrapped environment's class, and of what it holds."""
        targets = [*map(plain_path, targets)]
        ends = [p[: i.start()] for p in targets for i in re.finditer(r"\.(?![^[]*\])", p)]
        homes = {"self": world} | {f"self.{path}": read(world, path) for path in ends}
        parts = [c for root, home in homes.items() for c in _computed(home.__class__, root)]
        parts = [c for c in parts if not _meet([c.path], targets)]
        moved, chosen = {*targets}, dict[_Computed, None]()
        while new := [c for c in parts if c not in chosen and _meet(c.reads, moved)]:
            chosen |= dict.fromkeys(new)
            moved |= {c.path for c in new}
        used = frozenset[str]().union(*(_used(home.__class__) for home in homes.values()))
        return cls(tuple(targets), tuple(chosen), used)

    def look(self, world: Any) -> Look:
        """Read all that matters of an unwrapped environment after its reset."""
        formulas = [formula for c in self.parts if (formula := _formula(c.text))]
        reads = [*(c.reads for c in self.parts), *(formula.reads for formula in formulas)]
        paths = {*self.targets, *(c.path for c in self.parts), *chain.from_iterable(reads)}
        own = {name: _copied(value) for name, value in held(world).items()}
        return Look(own, {path: _copied(read(world, path)) for path in paths})

    def stale(self, worlds: Sequence[Look], make: Callable[[], Look]) -> dict[str, str]:
        """Return the attributes that do not follow in some worlds in which parameters are set.

        `make` looks at one in which they are not, with the same seed. The values are the
        expressions that give what the attributes should be, or "" where none is known.
        """
        if not self.parts:
            return {}
        nominal, rules, stale = make().at, list[_Computed](), dict[str, str]()
        for path in dict.fromkeys(c.path for c in self.parts):
            ways, present = [c for c in self.parts if c.path == path], nominal[path]
            holding = [c for c in ways if _same(_worth(c.text, nominal, {}), present)]
            unclear = not any(c.by_reset or _formula(c.text) for c in ways)
            rules += (ways if unclear else holding)[-1:]
        for world in (look.at for look in worlds):
            right: dict[str, Any] = {}
            for way in rules * len(rules):  # until the last of a chain is known
                present, value = world[way.path], _worth(way.text, world, right)
                if _formula(way.text) is None:
                    changed = [r in right or not _same(nominal[r], world[r]) for r in way.reads]
                    stays = any(changed) and _same(nominal[way.path], present)
                    value = MISSING if stays else present
                if not _same(value, present):
                    right[way.path], stale[way.path] = (
                        value,
                        way.text if _formula(way.text) else "",
                    )
        kept = {path for path in stale if re.sub(r".*\.|\[.*", "", path) in self.used}
        while more := {r for w in rules if w.path in kept for r in w.reads if r in stale} - kept:
            kept |= more
        return {path: text for path, text in stale.items() if path in kept}


def by_keywords(targets: Sequence[str], world: Look, make: Callable[..., Look]) -> dict[str, str]:
    """Return the attributes that differ where the constructor sets what parameters set in a world.

    It needs no source. The targets are keywords of the constructor, too.
    """
    try:
        other = make(*((target, world.at[target]) for target in targets)) if targets else world
    except Exception:  # the constructor, or a reset, does not take such a value
        return {}
    numbers = {name: value for name, value in other.own.items() if is_numeric(value)}
    present = {name: world.own.get(name, MISSING) for name in numbers}
    differing = [name for name, value in numbers.items() if not _same(value, present[name])]
    return {n: "" for n in differing if _same(make().own.get(n, MISSING), present[n])}


def _worth(text: str, world: Mapping[str, Any], values: Mapping[str, Any]) -> Any:
    """Compute what was read in source, values by name first; `MISSING` where it cannot be."""
    formula = _formula(text)
    if formula is None:
        return MISSING
    try:
        return formula.value({name: values.get(name, world[name]) for name in formula.reads})
    except Exception:  # the names may hold anything
        return MISSING


def read(world: Any, path: str) -> Any:
    """Return what a path names; `MISSING` also where a property raises or it is no path."""
    try:
        return read_path(world, path)
    except Exception:
        return MISSING


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value


def _meet(some: Iterable[str], others: Iterable[str]) -> bool:
    return any(overlap(one, other) for one in some for other in others)


def _same(one: Any, other: Any) -> bool:
    if not (is_numeric(one) and is_numeric(other)) or np.shape(one) != np.shape(other):
        return one is other
    return np.allclose(one, other, rtol=1e-5, atol=0.0, equal_nan=True)


def describe_stale(stale: Mapping[str, str]) -> str:
    """Say which attributes are stale and what fixes it; "" where there are none."""
    if not stale:
        return ""
    known = {path: text for path, text in stale.items() if text}
    unknown = " and ".join(path for path in stale if path not in known)
    keys = [(k if k.isidentifier() else json.dumps(k), json.dumps(known[k])) for k in known]
    toml = ", ".join(f"{key} = {text}" for key, text in keys)
    said = f" Write derived = {{ {toml} }} in TOML, derived={known} in Python." if known else ""
    if unknown:
        said += f" Set {unknown} by a Function, or the parameters by a Keyword."
    return (
        f"{' and '.join(stale)} {'was' if len(stale) < 2 else 'were'} computed in the constructor, "
        f"without the parameters, so that the physics is wrong.{said} "
    )


def describe_unscaled(targets: Sequence[str], world: Any) -> str:
    """Say whether masses of MuJoCo are set, among others, without their inertia; "" if not."""
    masses = [path for path in targets if path.startswith("model.body_mass")]
    inertias = [path.replace("mass", "inertia") for path in masses]
    if mujoco_model(world) is None or all(_meet([path], targets) for path in inertias):
        return ""
    return (
        "masses change, but not their moments of inertia. Let one factor multiply both: paths = "
        f"{json.dumps([*masses, *inertias])}, factor = true."
    )
