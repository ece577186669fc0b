"""The folder of a benchmark: its lock, its stores, and what its runs cost.

The results themselves are entries, see `board.benchmark.entries`. A file that cannot
be read or written is a FileError.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sada_gym.board.results.models import entry_name
from sada_gym.errors import StoreInUse, UserError
from sada_gym.evaluation.store_errors import check_usable, explained, in_use
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import RunFailure, RunKey, RunReport, slug
from sada_gym.experiment.target import Target
from sada_gym.foundations.files import MAX_JSON_BYTES, Strict, file_errors, read_file, write_file

ENTRIES, STORES, PICTURES = "entries", "stores", "pictures"
TABLE_FILE, TIMINGS_FILE, LOCK_FILE = "table.md", "timings.jsonl", ".lock"

_OURS = {ENTRIES, STORES, PICTURES, TABLE_FILE, TIMINGS_FILE}


class Timing(Strict):
    """What a run cost when it was made.

    Attributes:
        training_s: The process seconds of the adversary itself, training and sampling.
        evaluation_s: The process seconds of evaluations, without other worker processes.
        known: The number of evaluations that the store knew from other runs or earlier calls.
        wall_s: All seconds, measuring included.
        core_s: All process seconds, measuring included, without other worker processes.
        peak_memory_mib: The process's peak memory; None where the system does not measure it.
    """

    training_s: float
    evaluation_s: float
    evaluated: int
    known: int
    wall_s: float
    core_s: float | None = None
    peak_memory_mib: int | None


class RunTiming(RunKey, Timing):
    """What a run cost: a line of timings.jsonl, which is no part of any result."""


@dataclass(frozen=True, eq=False)
class RunDone:
    """A finished run as a worker gives it back.

    Attributes:
        samples: Its test samples; None after a failure.
        picture: The comparison of images as a PNG, if there is one.
        evaluations: The evaluations that the group's store still lacks; none where the worker had
            it open.
    """

    result: RunReport | RunFailure
    timing: Timing
    samples: Evaluations | None
    picture: bytes | None
    evaluations: tuple[Evaluations, ...]


def store_file(out: Path, target: Target, seed: int) -> Path:
    """Return the evaluation store that the runs of one target and seed share."""
    place = slug(f"{target.track}.{target.agent}" if target.agent else target.track)
    return out / STORES / f"{place}.{seed}.sqlite"


def reserve(out: Path) -> None:
    """Make a folder a benchmark's own; a ValueError, and no change, if it holds anything else."""
    if out.exists() and not out.is_dir():
        raise UserError(f"Expected a folder for the results, got the file {out}. Name another.")
    if out.exists() and not (out / LOCK_FILE).exists():
        # a folder that only holds entries is one whose runs were made on another machine
        shown = {entry.name for entry in out.iterdir() if not entry.name.startswith(".")}
        if not shown <= _OURS:
            raise UserError(
                f"Expected a new folder, an empty one or a benchmark's, got {out}, which holds "
                f"something else. Name another."
            )
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def sole_user(out: Path) -> Iterator[None]:
    """Keep other benchmarks out of a folder; the system ends that even when this one is killed.

    Raises:
        StoreInUse: If another benchmark is at work there.
        StoreError: If the folder cannot be locked.
    """
    path = out / LOCK_FILE
    check_usable(path)
    with ExitStack() as stack:
        with explained(path):
            lock = stack.enter_context(
                closing(sqlite3.connect(path, timeout=0, isolation_level=None))
            )
            try:
                lock.execute("BEGIN EXCLUSIVE")
            except sqlite3.OperationalError as error:
                if not in_use(error):
                    raise
                raise StoreInUse(
                    f"Expected to be the only benchmark in {out}, but another is at work there. "
                    "Wait for it to end, or name another folder."
                ) from error
        yield


def write_costs(out: Path, done: RunDone) -> None:
    """Write down what a finished run cost, and keep its picture; neither is part of its result."""
    key = done.result.settings.key
    line = json.dumps({**key.model_dump(), **done.timing.model_dump(mode="json")})
    path = out / TIMINGS_FILE
    with file_errors("write", path), path.open("ab+") as file:
        file.seek(max(file.tell() - 1, 0))
        torn = file.read(1) not in (b"", b"\n")  # a killed process left half a line
        file.write(f"{chr(10) if torn else ''}{line}\n".encode())
    if done.picture is not None:
        picture = novelty_picture(out, key)
        with file_errors("make the folder", picture.parent):
            picture.parent.mkdir(parents=True, exist_ok=True)
        write_file(picture, done.picture)


def read_costs(out: Path) -> list[RunTiming]:
    """Read what the runs of a folder cost, the oldest first; lines that were torn are left out."""
    path = out / TIMINGS_FILE
    if not path.exists():
        return []
    timings = []
    for line in read_file(path, MAX_JSON_BYTES).splitlines():
        with suppress(ValidationError):
            timings.append(RunTiming.model_validate_json(line))
    return timings


def picture_folder(out: Path, table: str, agent: str) -> Path:
    """Return the folder of the pictures of a table and agent."""
    return out / PICTURES / slug(f"{table}.{agent}" if agent else table)


def novelty_picture(out: Path, run: RunKey) -> Path:
    """Return the file of the images that a run of the first seed compared."""
    name = f"{slug(run.track)}.{entry_name(run.label)}.png"
    return picture_folder(out, run.table, run.agent) / "nearest-images" / name
