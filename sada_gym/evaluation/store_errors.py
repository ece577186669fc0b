"""Errors of the store's file, each with a sentence."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sada_gym.errors import StoreError, StoreInUse

_PRIMARY_CODE = 0xFF
"""SQLite's extended codes hold the primary one in their lowest byte."""

# sqlite3 names these constants only since Python 3.11
_PERM, _BUSY, _LOCKED, _READONLY, _IOERR, _CORRUPT = 3, 5, 6, 8, 10, 11
_FULL, _CANTOPEN, _NOTADB = 13, 14, 26

_KEPT = "What was stored before is kept"


def refuse_unusable(path: Path) -> None:
    """Refuse a path that cannot hold a store, before SQLite opens it.

    SQLite would wait for a FIFO's other end, and names no reason where a folder is read-only.

    Raises:
        StoreError: If the folder is missing, the path is no regular file, or either is read-only.
    """
    try:
        folder = stat.S_ISDIR(path.parent.stat().st_mode)
        mode = _mode(path) if folder else None
    except (FileNotFoundError, NotADirectoryError):
        folder = False
    except (OSError, ValueError) as error:  # a loop of links, a name too long, a NUL
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise StoreError(
            f"Expected a path for the evaluation store, got {str(path)!r} ({reason}). "
            "Name another file."
        ) from error
    if not folder:
        raise StoreError(f"Expected a folder for the store {path}, got none there. Make it first.")
    if mode is not None and stat.S_ISDIR(mode):
        raise StoreError(f"Expected a file for the evaluation store, got the folder {path}.")
    if mode is not None and not stat.S_ISREG(mode):
        raise StoreError(
            f"Expected a regular file for the evaluation store, got a pipe, socket or device in "
            f"{path}. Name another file."
        )
    # the folder too: SQLite keeps its write-ahead log beside the file
    for what, place in (("the file", path), ("its folder", path.resolve().parent)):
        if place.exists() and not os.access(place, os.W_OK):
            raise StoreError(_read_only(path, what))


def _mode(path: Path) -> int | None:
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return None


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn every error of SQLite into a `StoreError` with a sentence."""
    try:
        yield
    except sqlite3.Error as error:
        raise _translated(error, path) from error


def in_use(error: sqlite3.OperationalError) -> bool:
    """Whether another process holds the lock. Without an error code of Python, assume so."""
    return getattr(error, "sqlite_errorcode", _BUSY) & _PRIMARY_CODE in (_BUSY, _LOCKED)


def corrupt(path: Path, reason: str) -> str:
    """Give the sentence about a damaged store."""
    return (
        f"Expected a sound evaluation store, got a corrupt one in {path} ({reason}). "
        "It was left as it is; restore it from a copy, or name another file."
    )


def _translated(error: sqlite3.Error, path: Path) -> StoreError:
    code = getattr(error, "sqlite_errorcode", None)  # set by Python 3.11 and newer
    if code is None:
        return StoreError(_by_type(error, path))
    name = getattr(error, "sqlite_errorname", code)
    primary = code & _PRIMARY_CODE
    if primary in (_BUSY, _LOCKED):
        return StoreInUse(
            f"Expected to be the only user of the store {path}, but another run has it open. "
            "Wait for that run to end, or name another store."
        )
    if primary == _NOTADB:
        return StoreError(
            f"Expected an evaluation store (an SQLite file), got something else in {path}. "
            "It was left as it is; name another file."
        )
    if primary == _CORRUPT:
        return StoreError(corrupt(path, str(error)))
    if primary == _FULL:
        return StoreError(
            f"Expected room for more evaluations in the store {path}, but the disk is full. "
            f"{_KEPT}; free some space and resume the run."
        )
    if primary in (_READONLY, _PERM):
        return StoreError(_read_only(path, "the file"))
    if primary == _CANTOPEN:
        return StoreError(
            f"Expected to open or create the store {path} and its write-ahead log beside it, but "
            f"the operating system refused ({name}). Check the permissions of its folder, or name "
            "another file."
        )
    if primary == _IOERR:
        return StoreError(
            f"Expected to read and write the store {path}, but the disk or file system reported "
            f"an error ({name}): a broken or unplugged disk, a quota, or a network drive without "
            f"locks. {_KEPT}; mend that and resume the run, or name a store on another disk."
        )
    return StoreError(_unnamed(error, path, f"{name}: {error}"))


def _by_type(error: sqlite3.Error, path: Path) -> str:
    """Explain an error by its type: Python 3.10, and sqlite3's own errors, give no code."""
    if isinstance(error, sqlite3.OperationalError):
        return (
            f"Expected to use the store {path}, but SQLite could not ({error}). It may be open in "
            f"another run, on a full disk, or read-only. {_KEPT}; mend that and resume the run."
        )
    if type(error) is sqlite3.DatabaseError:
        return (
            f"Expected a sound evaluation store, got a corrupt one or something else in {path} "
            f"({error}). It was left as it is; restore it from a copy, or name another file."
        )
    return _unnamed(error, path, str(error))


def _unnamed(error: sqlite3.Error, path: Path, reason: str) -> str:
    if isinstance(error, sqlite3.ProgrammingError):
        return (
            f"Expected the store {path} to be open, and used in the thread that opened it: "
            f"{reason.rstrip('.')}. Make a new Oracle there."
        )
    return f"Expected to use the store {path}, but SQLite refused ({reason}). Name another file."


def _read_only(path: Path, what: str) -> str:
    return (
        f"Expected to write to the store {path}, but {what} is read-only. "
        "Change its permissions, or name a store in another folder."
    )
