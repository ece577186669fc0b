"""The evaluation store keeps every score of a run in one crash-safe SQLite file."""

from __future__ import annotations

import ctypes
import os
import sqlite3
import weakref
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import Self

from sada_gym.errors import StoreError, UserTypeError
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.store_errors import check_usable, corrupt, explained
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.files import as_path
from sada_gym.parameters import Mu

SCHEMA_VERSION = 1
"""SQLite's `user_version` holds it. Raise it when the tables change."""

_LOG_PAGES = 128
"""The write-ahead log is emptied into the file at this many pages of 4 KiB.

Seeds are random, so nearly every row of a chunk changes a page of its own, and the log soon holds
the whole file many times: SQLite's own limit, 1,000 pages, took 4 MB for 300 KB of scores.
"""

_APPLICATION_ID = int.from_bytes(b"SADA", "big")
_SCHEMA = f"""
BEGIN IMMEDIATE;
CREATE TABLE context (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    version INTEGER NOT NULL,
    settings TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    UNIQUE (name, version, settings, fingerprint)
);
CREATE TABLE evaluation (
    context INTEGER NOT NULL REFERENCES context (id),
    seed INTEGER NOT NULL,
    mu BLOB NOT NULL,
    score REAL NOT NULL,
    PRIMARY KEY (context, seed, mu)
) WITHOUT ROWID;
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
COMMIT;
"""
_INVALID = """
CREATE TABLE IF NOT EXISTS invalid (
    context INTEGER NOT NULL REFERENCES context (id),
    seed INTEGER NOT NULL,
    mu BLOB NOT NULL,
    reason TEXT NOT NULL,
    PRIMARY KEY (context, seed, mu)
) WITHOUT ROWID
"""
"""The invalid worlds among the evaluations. A store without any has no such table."""
_COLUMNS = {
    *(f"context.{name}" for name in ("id", "name", "version", "settings", "fingerprint")),
    *(f"evaluation.{name}" for name in ("context", "seed", "mu", "score")),
}
_INVALID_COLUMNS = {f"invalid.{name}" for name in ("context", "seed", "mu", "reason")}
_UNSOUND = """
SELECT context FROM evaluation GROUP BY context HAVING
    count(*) > total(typeof(score) = 'real' AND score BETWEEN 0.0 AND 1.0)
    OR count(*) > total(typeof(seed) = 'integer')
    OR count(*) > total(typeof(mu) = 'blob' AND length(mu) % 4 = 0)
    OR min(length(mu)) < max(length(mu))
"""


class EvaluationStore:
    """Keeps scores by (context, mu, seed) in an SQLite file that one process at a time has open.

    It uses a write-ahead log in exclusive locking mode. The operating system frees the lock even
    after SIGKILL, and no shared memory is needed, so that the file may be on a network drive. With
    `synchronous = NORMAL`, a commit survives the death of the process. A power cut may lose the
    last commits, which are then evaluated again, but it never corrupts the file. The log is small
    (half a megabyte) and is removed when the store is closed.

    Args:
        path: The file, which is created if it is missing. Its folder must exist.

    Raises:
        StoreError: If the file is not an evaluation store of this schema, is corrupt, or is open
            elsewhere. It is left unchanged. Every method raises this error if the file cannot be
            read or written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = as_path(path, "an evaluation store")
        self._process = os.getpid()
        check_usable(self.path)
        with explained(self.path):
            # absolute: SQLite would take the name ":memory:" for no file at all
            self._own = sqlite3.connect(self.path.absolute(), timeout=0.0, isolation_level=None)
            try:
                self._open()
            except BaseException:
                self._own.close()
                raise
            self._identity = self._on_disk()
        _open_stores.add(self)

    def is_in_place(self) -> bool:
        """Whether the file is still the one that was opened, not removed or replaced."""
        try:
            return self._on_disk() == self._identity
        except OSError:
            return False

    def _on_disk(self) -> tuple[int, int]:
        status = self.path.absolute().stat()
        return status.st_dev, status.st_ino

    @property
    def _connection(self) -> sqlite3.Connection:
        # SQLite's connections do not survive a fork
        if os.getpid() != self._process:
            raise StoreError(
                f"Expected the store {self.path} to be used in the process that opened it, got a "
                "copy in a forked one. Use workers=, or a store of its own in each process."
            )
        return self._own

    def _open(self) -> None:
        # Nothing but SQLite may open the file: closing any other descriptor of it would free
        # the lock (POSIX). So SQLite reads the file's identity too, before anything is written.
        run = self._connection.execute
        run("PRAGMA locking_mode = EXCLUSIVE")
        tables = run("SELECT count(*) FROM sqlite_master").fetchone()[0]
        writer = run("PRAGMA application_id").fetchone()[0]
        version = run("PRAGMA user_version").fetchone()[0]
        if tables == writer == version == 0:
            self._connection.executescript(_SCHEMA)
        elif writer != _APPLICATION_ID:
            raise StoreError(
                f"Expected an evaluation store, got another program's SQLite file in {self.path}. "
                "It was left as it is; name another file."
            )
        elif version != SCHEMA_VERSION:
            raise StoreError(
                f"Expected an evaluation store of schema {SCHEMA_VERSION}, got schema {version} in "
                f"{self.path}. Open it with the sada_gym that wrote it, or name a new file."
            )
        elif (verdict := run("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
            raise corrupt(self.path, " ".join(verdict.split()))
        self._check_content()
        run("PRAGMA journal_mode = WAL")
        run(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
        run(f"PRAGMA journal_size_limit = {_LOG_PAGES * 4096}")
        run("PRAGMA synchronous = NORMAL")
        run("BEGIN IMMEDIATE")  # takes the lock now, not with the first chunk
        run("COMMIT")

    def _check_content(self) -> None:
        columns = self._connection.execute(
            "SELECT t.name || '.' || c.name FROM sqlite_master AS t, pragma_table_info(t.name) AS c"
        ).fetchall()
        known = {name for (name,) in columns}
        missing = sorted(_COLUMNS - known)
        self._has_invalid = any(name.startswith("invalid.") for name in known)
        if self._has_invalid:
            missing += sorted(_INVALID_COLUMNS - known)
        if missing:
            raise corrupt(self.path, f"it lacks {', '.join(missing)}")
        if self._connection.execute(_UNSOUND).fetchone() is not None:
            raise corrupt(
                self.path, "it holds a score that is not a number from 0 to 1, or a bad mu"
            )

    def context(self, key: ApplicationKey) -> int:
        """Return the number of an application in this store; a new application gets a new one.

        Raises:
            StoreError: If the store holds evaluations of the same application in another version.
        """
        row = {**key.model_dump(), "settings": key.settings_json}
        run = self._connection.execute
        with explained(self.path):
            other = run(
                "SELECT version FROM context WHERE name = :name AND version != :version", row
            ).fetchone()
            if other:
                raise StoreError(
                    f"Expected evaluations of {key.name}-v{key.version} in {self.path}, "
                    f"got some of {key.name}-v{other[0]}: scores of two versions don't mix. "
                    "Name a new store, or install the sada_gym that has that version."
                )
            run(
                "INSERT OR IGNORE INTO context (name, version, settings, fingerprint) "
                "VALUES (:name, :version, :settings, :fingerprint)",
                row,
            )
            row_id = run(
                "SELECT id FROM context WHERE name = :name AND version = :version "
                "AND settings = :settings AND fingerprint = :fingerprint",
                row,
            ).fetchone()
        return int(row_id[0])

    def lookup(self, context: int, mu: Mu, seeds: Sequence[int]) -> Floats:
        """Return the stored scores, (n,) float64, with NaN for those that are not stored.

        Args:
            context: A number that `context` returned.
            mu: (n, d) float32.
            seeds: n evaluation seeds.
        """
        scores = np.full(len(mu), np.nan)
        query = "SELECT score FROM evaluation WHERE context = ? AND seed = ? AND mu = ?"
        with explained(self.path):
            for i, (seed, row) in enumerate(zip(seeds, mu, strict=True)):
                stored = self._connection.execute(query, (context, seed, row.tobytes())).fetchone()
                if stored is not None:
                    scores[i] = stored[0]
        return scores

    def invalid(self, context: int, mu: Mu, seeds: Sequence[int]) -> dict[int, str]:
        """Return the stored reasons of invalid worlds, by their row. Arguments as for `lookup`."""
        if not self._has_invalid:
            return {}
        with explained(self.path):
            stored = self._connection.execute(
                "SELECT seed, mu, reason FROM invalid WHERE context = ?", (context,)
            ).fetchall()
        reasons = {(seed, row): str(reason) for seed, row, reason in stored}
        keys = ((seed, row.tobytes()) for seed, row in zip(seeds, mu, strict=True))
        return {i: reasons[key] for i, key in enumerate(keys) if key in reasons}

    def evaluations(self, context: int, seeds: Sequence[int]) -> Evaluations | None:
        """Return the evaluations of n seeds; None if n is 0 or a seed is not stored.

        The order of evaluations with the same seed is not known. `context` is a number that the
        method of that name returned.
        """
        query = "SELECT mu, score FROM evaluation WHERE context = ? AND seed = ? ORDER BY mu"
        rows, taken = [], Counter[int]()
        with explained(self.path):
            for seed in seeds:
                stored = self._connection.execute(query, (context, seed)).fetchall()
                if not stored:
                    return None
                rows.append(stored[min(taken[seed], len(stored) - 1)])
                taken[seed] += 1
        if not rows:
            return None
        mu = np.array([np.frombuffer(mu, np.float32) for mu, _ in rows], np.float32)
        score = np.array([score for _, score in rows], np.float64)
        invalid = np.zeros(len(mu), np.bool_)
        invalid[[*self.invalid(context, mu, seeds)]] = True
        return Evaluations(mu, score, np.array(seeds, np.int64), invalid)

    def commit(
        self,
        context: int,
        mu: Mu,
        seeds: Sequence[int],
        scores: Floats,
        invalid: Mapping[int, str] | None = None,
    ) -> None:
        """Store the scores of one chunk in one transaction, whole or not at all.

        Args:
            context: A number that `context` returned.
            mu: (n, d) float32.
            seeds: n evaluation seeds.
            scores: (n,) float64 in [0, 1].
            invalid: The reasons of invalid worlds, by their row.
        """
        rows = zip(seeds, mu, scores, strict=True)
        with explained(self.path), self._connection:  # commits, or rolls back after an error
            self._connection.execute("BEGIN IMMEDIATE")
            self._connection.executemany(
                "INSERT OR IGNORE INTO evaluation VALUES (?, ?, ?, ?)",
                ((context, seed, row.tobytes(), float(score)) for seed, row, score in rows),
            )
            if invalid:
                self._connection.execute(_INVALID)
                self._connection.executemany(
                    "INSERT OR IGNORE INTO invalid VALUES (?, ?, ?, ?)",
                    ((context, seeds[i], mu[i].tobytes(), why) for i, why in invalid.items()),
                )
        self._has_invalid = self._has_invalid or bool(invalid)

    def __len__(self) -> int:
        """Count the evaluations of all contexts."""
        with explained(self.path):
            count = self._connection.execute("SELECT count(*) FROM evaluation").fetchone()[0]
        return int(count)

    def close(self) -> None:
        """Close the file. May be repeated."""
        if os.getpid() == self._process:  # a forked copy would delete the log that we write to
            with explained(self.path):
                self._own.close()

    def __del__(self) -> None:
        """Close a store that was forgotten: Python frees its connection, and the lock, too late."""
        if hasattr(self, "_own"):
            with suppress(Exception):  # another thread's, or a disk that is gone
                self.close()

    def __reduce__(self) -> Any:
        """Raise TypeError: a store cannot be copied."""
        raise UserTypeError(
            f"Expected the store {self.path} to stay where it was opened, got a copy or a pickle "
            "of it, such as with copy.deepcopy(oracle). Copy the application, and name another "
            "store."
        )

    def __enter__(self) -> Self:
        """Return the store itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the store."""
        self.close()


_open_stores: weakref.WeakSet[EvaluationStore] = weakref.WeakSet()


def _leave_to_the_parent() -> None:
    """Let a forked process never free a connection that it inherited.

    SQLite would believe that it is the last user, and delete the write-ahead log that the parent
    goes on writing to: scores that were committed would be lost if the parent was killed.
    """
    for store in _open_stores:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(store._own))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_the_parent)
