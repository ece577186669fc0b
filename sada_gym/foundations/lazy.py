"""Objects that are named by strings and loaded on first use, so that importing stays light."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def load(path: str) -> Any:
    """Load the object that `module:name` names."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def lazy_names(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the `__getattr__` of a package whose names are loaded on first use.

    Args:
        package: The package's `__name__`.
        modules: The module of the package that defines each name.
    """

    def find(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return load(f"{package}.{modules[name]}:{name}")

    return find
