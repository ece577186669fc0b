"""Compiles functions by numba and keeps their machine code between runs.

Numba compiles again when the file of a kernel changes. It doesn't notice when a constant or a
function changes that the kernel takes from another file: it would use the old machine code, and
scores would silently be wrong. So the machine code lies in a folder whose name holds a digest of
all sources that a kernel can depend on: its own module and all modules of the package that this
one imports, directly or not.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba as nb
from numba.misc.appdirs import AppDirs

FOLDER = "sada_gym_kernels"
UNUSED_DAYS = 30.0
"""Machine code of older sources is removed when it was not used for so many days."""

_Function = TypeVar("_Function", bound=Callable[..., Any])
_PACKAGE = Path(__file__).resolve().parents[1]
_SETTINGS: Any = nb.config
_APP_DIRS: Any = AppDirs
_LOCK = threading.Lock()


def kernel(function: _Function, **options: Any) -> _Function:
    """Compile a function of numbers and arrays.

    Divisions are NumPy's (Python's check for zero costs a branch each), and there is no fast-math,
    so that equal numbers give equal bytes.
    """
    folder = machine_code_folder(Path(function.__code__.co_filename).resolve())
    options |= {"cache": folder is not None, "nogil": True, "error_model": "numpy"}
    with _LOCK:  # modules may be imported by several threads
        users: str = _SETTINGS.CACHE_DIR
        _SETTINGS.CACHE_DIR = str(folder or users)
        try:
            compiled: Any = nb.njit(**options)(function)
        finally:
            _SETTINGS.CACHE_DIR = users
    return cast(_Function, compiled)


def uncounted(function: _Function) -> _Function:
    """Compile a kernel that makes no array, without counts of references.

    Numba counts references wherever an array is passed on; drawing then takes a fifth longer.
    """
    return kernel(function, _nrt=False)


def inlined(function: _Function) -> _Function:
    """Compile a function as a part of each kernel that calls it, even from another file.

    LLVM puts it into its callers. Where numba does so itself (`inline="always"`), it infers the
    types of each copy again, and compiling takes three times as long.
    """
    options: dict[str, Any] = {"forceinline": True, "error_model": "numpy", "_nrt": False}
    compiled: Any = nb.njit(**options)(function)
    return cast(_Function, compiled)


@functools.cache
def machine_code_folder(file: Path) -> Path | None:
    """Make the folder of the machine code of one module's kernels.

    The folder lies in `NUMBA_CACHE_DIR` if that is set. Otherwise it lies beside the package, or in
    the user's folder for caches if the package's is not writable. The result is None if none of
    them is writable: each process then compiles for itself.
    """
    name = _module_name(file)
    for home in _homes():
        folder = home / FOLDER / f"{name}-{sources_digest(file)}"
        try:
            is_new = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
            folder.touch()  # its time says when it was last used
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        if is_new:
            _remove_unused(folder.parent, name)
        return folder
    return None


def _homes() -> Iterator[Path]:
    if _SETTINGS.CACHE_DIR:
        yield Path(_SETTINGS.CACHE_DIR)
    yield _PACKAGE / "__pycache__"
    users: Any = _APP_DIRS(appname="numba", appauthor=False)
    yield Path(users.user_cache_dir)


def _remove_unused(home: Path, name: str) -> None:
    for folder in home.glob(f"{name}-{'[0-9a-f]' * 16}"):
        try:
            unused_s = time.time() - folder.stat().st_mtime
        except OSError:  # another process has removed it
            continue
        if unused_s > UNUSED_DAYS * 86_400:
            shutil.rmtree(folder, ignore_errors=True)


def was_compiled(source: Path) -> bool:
    """Say whether an earlier run kept the machine code of one of a source's kernels."""
    folder = f"{_module_name(source)}-{sources_digest(source)}"
    return any(True for home in _homes() for _ in (home / FOLDER / folder).rglob("*.nbi"))


def _closure(file: Path) -> set[Path]:
    sources, unread = set[Path](), [file.resolve()]
    while unread:
        source = unread.pop()
        if source not in sources:
            sources.add(source)
            unread += imported_sources(source)
    return sources


@functools.cache
def sources_digest(file: Path) -> str:
    """Digest a module's source and those of the modules that it imports, directly or not.

    Of the modules outside of the package only the given one counts.
    """
    digest = hashlib.sha256()
    for source in sorted(_closure(file)):
        content = source.read_bytes()
        digest.update(f"{_module_name(source)} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


@functools.cache
def imported_sources(file: Path) -> tuple[Path, ...]:
    """List the files of this package that a module imports, anywhere in its code."""
    stems = [
        stem
        for node in ast.walk(ast.parse(file.read_bytes()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for stem in _named(node, file)
        if stem.is_relative_to(_PACKAGE)
    ]
    files = (path for stem in stems for path in (stem.with_suffix(".py"), stem / "__init__.py"))
    return tuple(sorted({path for path in files if path.is_file()}))


def _named(node: ast.Import | ast.ImportFrom, file: Path) -> Iterator[Path]:
    if isinstance(node, ast.Import):
        for alias in node.names:
            parts = alias.name.split(".")
            for depth in range(1, len(parts) + 1):  # `import a.b` gives access to a
                yield _PACKAGE.parent.joinpath(*parts[:depth])
        return
    start = file.parents[node.level - 1] if node.level else _PACKAGE.parent
    module = start.joinpath(*node.module.split(".")) if node.module else start
    yield module
    for alias in node.names:
        yield module / alias.name


def _module_name(file: Path) -> str:
    inside = file.relative_to(_PACKAGE) if file.is_relative_to(_PACKAGE) else Path(file.name)
    return ".".join(inside.with_suffix("").parts)
