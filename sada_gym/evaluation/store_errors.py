"""Errors of the store's file, with clear messages."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sada_gym.errors import StoreError, StoreInUse

_PRIMARY = 0xFF
"""SQLite's extended codes hold the primary one in their lowest byte."""

# sqlite3 names these constants only since Python 3.11
_PERM, _BUSY, _LOCKED, _READONLY, _IOERR, _CORRUPT = 3, 5, 6, 8, 10, 11
_FULL, _CANTOPEN, _NOTADB = 13, 14, 26

_KEPT = "What was stored before is kept"
_IN_USE = (
    "Expected to be the only user of the store {path}, but another run has it open. Wait for that "
    "run to end, or name another store."
)
_READ_ONLY = (
    "Expected to write to the store {path}, but {what} is read-only. Change its permissions, or "
    "name a store in another folder."
)
_BAD_CONTENT = (
    "Expected a sound evaluation store, got a corrupt one in {path} ({error}). It was left as it "
    "is; restore it from a copy, or name another file."
)
_BY_CODE = {
    _BUSY: _IN_USE,
    _LOCKED: _IN_USE,
    _READONLY: _READ_ONLY,
    _PERM: _READ_ONLY,
    _CORRUPT: _BAD_CONTENT,
    _NOTADB: (
        "Expected an evaluation store (an SQLite file), got something else in {path}. It was left "
        "as it is; name another file."
    ),
    _FULL: (
        "Expected room for more evaluations in the store {path}, but the disk is full. "
        f"{_KEPT}; free some space and resume the run."
    ),
    _CANTOPEN: (
        "Expected to open or create the store {path} and its write-ahead log beside it, but the "
        "operating system refused ({name}). Check the permissions of its folder, or name another "
        "file."
    ),
    _IOERR: (
        "Expected to read and write the store {path}, but the disk or file system reported an "
        "error ({name}): a broken or unplugged disk, a quota, or a network drive without locks. "
        f"{_KEPT}; fix that and resume the run, or name a store on another disk."
    ),
}
# Python 3.10, and sqlite3's own errors, give no code
_BY_TYPE: dict[type[sqlite3.Error], str] = {
    sqlite3.OperationalError: (
        "Expected to use the store {path}, but SQLite could not ({error}). It may be open in "
        f"another run, on a full disk, or read-only. {_KEPT}; fix that and resume the run."
    ),
    sqlite3.DatabaseError: (
        "Expected a sound evaluation store, got a corrupt one or something else in {path} "
        "({error}). It was left as it is; restore it from a copy, or name another file."
    ),
}


def check_usable(path: Path) -> None:
    """Raise `StoreError` for a path that cannot hold a store, before SQLite opens it.

    SQLite would wait for a FIFO's other end, and names no reason where a folder is read-only.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        mode = stat.S_IFREG  # a file that can be made
        if not path.parent.is_dir():
            raise StoreError(
                f"Expected a folder for the store {path}, got none there. Make it first."
            ) from error
    except (OSError, ValueError) as error:  # a loop of links, a name too long, a NUL
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise StoreError(
            f"Expected a path for the evaluation store, got {str(path)!r} ({reason}). "
            "Name another file."
        ) from error
    if stat.S_ISDIR(mode):
        raise StoreError(f"Expected a file for the evaluation store, got the folder {path}.")
    if not stat.S_ISREG(mode):
        raise StoreError(
            f"Expected a regular file for the evaluation store, got a pipe, socket or device in "
            f"{path}. Name another file."
        )
    # the folder too: SQLite keeps its write-ahead log beside the file
    for what, place in (("the file", path), ("its folder", path.resolve().parent)):
        if place.exists() and not os.access(place, os.W_OK):
            raise StoreError(_READ_ONLY.format(path=path, what=what))


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn every error of SQLite into a `StoreError` with a clear message."""
    try:
        yield
    except sqlite3.Error as error:
        raise _translated(error, path) from error


def in_use(error: sqlite3.OperationalError) -> bool:
    """Return whether another process holds the lock. Without an error code of Python, assume so."""
    return getattr(error, "sqlite_errorcode", _BUSY) & _PRIMARY in (_BUSY, _LOCKED)


def corrupt(path: Path, reason: str) -> StoreError:
    """Return the error of a damaged store."""
    return StoreError(_BAD_CONTENT.format(path=path, error=reason))


def _translated(error: sqlite3.Error, path: Path) -> StoreError:
    code = getattr(error, "sqlite_errorcode", None)  # set by Python 3.11 and newer
    name = getattr(error, "sqlite_errorname", code)
    sentence = _BY_TYPE.get(type(error)) if code is None else _BY_CODE.get(code & _PRIMARY)
    if sentence is not None:
        kind = StoreInUse if sentence is _IN_USE else StoreError
        return kind(sentence.format(path=path, error=error, name=name, what="the file"))
    reason = str(error) if code is None else f"{name}: {error}"
    if isinstance(error, sqlite3.ProgrammingError):
        return StoreError(
            f"Expected the store {path} to be open, and used in the thread that opened it: "
            f"{reason.rstrip('.')}. Make a new Oracle there."
        )
    return StoreError(
        f"Expected to use the store {path}, but SQLite refused ({reason}). Name another file."
    )
