"""Runs a function in a fresh process, and imports files that are on no module path."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import pickle
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from sada_gym.errors import UserError, described
from sada_gym.evaluation.spawn import spawn_context

Result = TypeVar("Result")

_FILE = "_file_"
"""The beginning of the names of modules that were imported by their path."""


def import_file(path: str | Path, name: str | None = None) -> ModuleType:
    """Import a Python file by its path, with its folder on the module path as a script has it.

    By default its name follows from the path, in every process. It raises `UserError` if there is
    no such Python file, or running it raises.
    """
    path = Path(path).resolve()
    if path.suffix != ".py" or not path.is_file():
        raise UserError(f"Expected an existing Python file (*.py), got {str(path)!r}.")
    name = name or f"{_FILE}{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever a user's file may raise
        del sys.modules[name]
        raise UserError(
            f"Expected {str(path)!r} to run when imported, got {described(error)}."
        ) from error
    return module


def in_fresh_process(function: Callable[..., Result], *args: Any, home: type) -> Result:
    """Call a function in a process that shares nothing with this one.

    It must stand at the top level of an importable module, or be a method. The process first
    imports the module of the class `home`, from its file where it is on no module path. It raises
    `UserError` if the arguments can't be pickled.
    """
    files = [
        (name, module.__file__)
        for name, module in sys.modules.items()
        if name.startswith(_FILE) and module.__file__ is not None
    ]
    try:
        payload = pickle.dumps((function, args))
    except Exception as error:  # pickle raises whatever a `__reduce__` raises
        raise UserError(
            f"Expected {home.__name__} to be picklable, got {described(error)}. Keep "
            "only picklable attributes, and define the class at the top level of a module."
        ) from error
    file = getattr(sys.modules[home.__module__], "__file__", None)
    with ProcessPoolExecutor(1, mp_context=spawn_context()) as pool:
        result: Result = pool.submit(_call, home.__module__, file, files, payload).result()
    return result


def _call(module: str, file: str | None, files: Sequence[tuple[str, str]], payload: bytes) -> Any:
    for name, path in files:  # a function of the user's may be defined in one of them
        if Path(path).is_file():
            import_file(path, name)
    if module != "__main__":  # spawn itself has imported that one
        try:
            importlib.import_module(module)
        except ModuleNotFoundError:
            if file is None:
                raise
            import_file(file, module)
    function, args = pickle.loads(payload)
    return function(*args)
