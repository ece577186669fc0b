"""The code of a user's own, by which stored scores are known: installed packages have versions."""

from __future__ import annotations

import ast
import hashlib
import sys
import sysconfig
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache, partial
from importlib.util import resolve_name
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

_INSTALLED = {"site-packages", "dist-packages"}
_SHORT = 16


class _Statement(NamedTuple):
    text: str
    used: frozenset[str]
    imported: tuple[tuple[str, str], ...]
    """Modules, and what is taken from each."""


def own_sources(objects: Iterable[Any]) -> dict[str, str]:
    """Return a hash of the code of classes and functions of a user's own, by the file's name.

    It covers what they name: other functions, classes and constants of their modules, and of
    modules of the user's own that these import. Comments do not count. What nobody can read, such
    as the cell of a notebook, is left out.
    """
    texts: dict[Path, set[str]] = {}
    waiting, seen = [_home(given) for given in objects], set[tuple[Path, str]]()
    while waiting:
        module, name = waiting.pop()
        file = _own_file(module)
        if file is None or (file, name) in seen:
            continue
        seen.add((file, name))
        statements = _statements(file, file.stat().st_mtime_ns)
        whole = chain.from_iterable(statements.values())
        for statement in statements.get(name, ()) if name else whole:
            texts.setdefault(file, set()).add(statement.text)
            waiting += [(module, other) for other in statement.used & {*statements}]
            for origin, theirs in statement.imported:
                with suppress(ImportError):  # of a script, which has no package
                    there = resolve_name(origin, sys.modules[module].__package__ or "")
                    waiting += [(there, theirs), (f"{there}.{theirs}", "")]
    return {
        file.name: hashlib.sha256("\n".join(sorted(found)).encode()).hexdigest()[:_SHORT]
        for file, found in sorted(texts.items())
    }


def _home(given: Any) -> tuple[str, str]:
    """Return the module of a class, a function or an object's class, and its name there."""
    while isinstance(given, partial):
        given = given.func
    named = given if hasattr(given, "__qualname__") else type(given)
    return str(named.__module__), named.__qualname__.partition(".")[0]


def _own_file(module: str) -> Path | None:
    path = getattr(sys.modules.get(module), "__file__", None)
    if path is None or module.partition(".")[0] == "sada_gym":
        return None
    file = Path(path).resolve()
    library = Path(sysconfig.get_path("stdlib")).resolve()
    is_own = not _INSTALLED & {*file.parts} and library not in file.parents
    return file if is_own and file.suffix == ".py" and file.is_file() else None


@lru_cache(maxsize=64)
def _statements(file: Path, changed: int) -> dict[str, list[_Statement]]:  # noqa: ARG001
    """Return the statements of a module by the names that they define."""
    try:
        body = ast.parse(file.read_bytes()).body
    except (SyntaxError, ValueError, OSError):  # it was edited since it was imported
        return {}
    found: dict[str, list[_Statement]] = {}
    for node in body:
        parts = [*ast.walk(node)]
        names = [part for part in parts if isinstance(part, ast.Name)]
        stored = {part.id for part in names if isinstance(part.ctx, ast.Store)}
        imported: list[tuple[str, str]] = []
        for part in parts:
            if isinstance(part, ast.Import | ast.ImportFrom):
                stored |= {(a.asname or a.name).partition(".")[0] for a in part.names}
                if isinstance(part, ast.Import):
                    imported += [(a.name, "") for a in part.names]
                else:
                    origin = "." * part.level + (part.module or "")
                    imported += [(origin, a.name) for a in part.names]
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            stored = {node.name}
        used = frozenset(part.id for part in names)
        statement = _Statement(ast.unparse(node), used, tuple(imported))
        for name in stored:
            found.setdefault(name, []).append(statement)
    return found
