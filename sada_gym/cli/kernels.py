"""Says whether a run compiles kernels first, which Numba does once, in about a minute."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

COMPILING = "Compiling kernels for the first run (about a minute)"


def will_compile(package: str = "sada_gym") -> bool:
    """Say whether a loaded module has kernels of which no earlier run has kept one."""
    modules = [name for name in sys.modules if f"{name}.".startswith(f"{package}.")]
    return any(kept and not any(kept) for kept in (list(_kept(name)) for name in modules))


def _kept(name: str) -> Iterator[bool]:
    """Say of each kernel that can be kept on disk whether it is there."""
    if "numba" not in sys.modules:
        return
    from numba.core.dispatcher import Dispatcher

    for member in list(vars(sys.modules[name]).values()):
        if not isinstance(member, Dispatcher) or member.__module__ != name:
            continue
        kernel: Any = member
        folder, code = kernel.stats.cache_path, kernel.py_func.__code__
        if folder is not None:
            index = f"*.{kernel.py_func.__qualname__}-{code.co_firstlineno}.*.nbi"
            yield any(Path(folder).glob(index))
