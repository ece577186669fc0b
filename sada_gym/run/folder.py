"""The folder of a run: who owns it, what is written there, and what a finished run left."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sada_gym.errors import FileError, StoreError, UserError
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.differences import check_same_record
from sada_gym.experiment.record import RunSettings
from sada_gym.foundations.files import (
    MAX_TOML_BYTES,
    Strict,
    read_arrays,
    read_file,
    read_model,
    write_file,
    write_model,
)
from sada_gym.run.given import Given

SETTINGS_FILE = "attack.json"
RESULT_FILE = "result.json"
SAMPLES_FILE = "samples.npz"
STORE_FILE = "run.sqlite"
ELSEWHERE_FILE = "elsewhere.sqlite"
"""Holds the scores of a run's worlds on fresh seeds, and in other worlds."""
ADVERSARY_FOLDER = "adversary"
REPORT_FILE = "report.html"

_SOURCE_FILE = "application.txt"
"""In runs of format 1 it names the TOML file that described the application, where one did."""


class RunRecord(Strict):
    """The contents of attack.json: what a run does, and how what it attacks was given."""

    format: Literal[2] = 2
    settings: RunSettings
    given: Given


def read_record(folder: Path) -> RunRecord:
    """Read attack.json of a run; a FileError if it is missing, damaged, or of a later version."""
    path = folder / SETTINGS_FILE
    try:
        return read_model(path, RunRecord)
    except FileError:
        with suppress(FileError):  # format 1: the settings alone
            settings = read_model(path, RunSettings)
            return RunRecord(settings=settings, given=_given_before(folder, settings))
        raise


def _given_before(folder: Path, settings: RunSettings) -> Given:
    """Find out how what a run of format 1 attacked was given."""
    target, source = settings.experiment.target, folder / _SOURCE_FILE
    if source.is_file():
        path = Path(os.fsdecode(read_file(source, MAX_TOML_BYTES)).strip())
        return Given(by="toml", file=path.absolute().as_uri())
    if {"environment", "order"} <= set(target.application.settings):
        return Given(by="python")
    return Given(by="id", id=target.track, keywords=None)


class TemporaryFolder:
    """A folder for a run, at `path`, that is removed with this object."""

    def __init__(self) -> None:
        parent = tempfile.mkdtemp(prefix="sada-gym-")
        self.path = Path(parent) / "run"
        weakref.finalize(self, shutil.rmtree, parent, ignore_errors=True)


def write_samples(path: Path, samples: Evaluations) -> None:
    """Write test samples as NPZ: mu (n, d) float32, score (n,) float64, seed (n,) int64.

    Where worlds are invalid, there is `invalid`, (n,) bool, too.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {"mu": samples.mu, "score": samples.score, "seed": samples.seed}
    if samples.invalid.any():
        arrays["invalid"] = samples.invalid
    np.savez(buffer, **arrays)
    write_file(path, buffer.getvalue())


def read_samples(path: Path) -> Evaluations:
    """Read the test samples of a run, `samples.npz`; raises a FileError if they are damaged."""
    kinds = {"mu": ("f4", 2), "score": ("f8", 1), "seed": ("i8", 1)}
    arrays = read_arrays(path, kinds, optional={"invalid": ("b1", 1)})
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise FileError(
            f"Expected as many mu as scores and seeds in {path}, got {counts}. "
            "Restore the file, or make it again."
        )
    return Evaluations(**arrays)


@dataclass(frozen=True)
class RunFolder:
    """A folder that is a run's own.

    Attributes:
        made: What reserving it made: folders, the innermost first. None where it held the run.
    """

    folder: Path
    made: tuple[Path, ...] | None

    def check(self, settings: RunSettings, store: EvaluationStore) -> None:
        """Refuse to write results where the folder is not this run's any more.

        Raises:
            FileError: If the folder, its settings or its store were removed or replaced.
        """
        try:
            same = read_record(self.folder).settings == settings
            if same and store.is_in_place():
                return
            what = "another run's files" if not same else f"another {STORE_FILE}"
        except FileError as error:
            what = str(error)
        raise FileError(
            f"Expected the results' folder {self.folder} as this run left it, got changes that "
            f"something else made during the run ({what}). Nothing was written. Run it again in "
            "a folder of its own."
        )

    def release(self) -> None:
        """Remove the folder if its run made no evaluation, so that nothing of it is left."""
        store = self.folder / STORE_FILE
        if self.made is None:
            return
        # what cannot be tidied up is left: the error that ended the run says more
        with suppress(OSError, StoreError):
            if store.exists():
                with EvaluationStore(store) as kept:
                    if len(kept):
                        return
            for path in (store, self.folder / SETTINGS_FILE):
                path.unlink(missing_ok=True)
            # with a budget of 0 the adversary is saved before the first evaluation
            shutil.rmtree(self.folder / ADVERSARY_FOLDER, ignore_errors=True)
            for made in self.made:
                made.rmdir()


def check_free(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that an attack cannot have, whatever its settings are.

    Raises:
        ValueError: If it is a file, holds a run and `resume` is not set, or holds results of an
            unknown run.
    """
    if folder.exists() and not folder.is_dir():
        raise UserError(f"Expected a folder for the results, got the file {folder}. Name another.")
    if (folder / SETTINGS_FILE).exists():
        if not resume:
            raise UserError(
                f"Expected a new folder for the results, got {folder}, which holds a run. "
                "Resume that run with --resume (resume=True), or name another folder."
            )
        return
    for name in (RESULT_FILE, SAMPLES_FILE, STORE_FILE, ADVERSARY_FOLDER):
        if (folder / name).exists():
            raise UserError(
                f"Expected {folder} to hold no results, got {name} in it without the "
                f"{SETTINGS_FILE} that says which run it belongs to. Name another folder."
            )


def reserve_folder(folder: Path, record: RunRecord, *, resume: bool) -> RunFolder:
    """Make a folder an attack's own by writing its record there, or find it there.

    Another run, or the same one without `resume`, is a ValueError. Nothing is changed then.
    """
    check_free(folder, resume=resume)
    path = folder / SETTINGS_FILE
    if path.exists():
        check_same_record(
            f"the settings that the run in {folder} was started with",
            read_record(folder).settings.model_dump(mode="json"),
            record.settings.model_dump(mode="json"),
        )
        return RunFolder(folder, None)
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    reserved = RunFolder(folder, tuple(missing))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_model(path, record)
    except BaseException:
        reserved.release()
        raise
    return reserved


def is_saved(adversary: Path) -> bool:
    """Whether a folder holds a trained adversary."""
    # after a loss of power files may be there and empty
    files = [path for path in adversary.rglob("*") if path.is_file()]
    return adversary.is_dir() and all(path.stat().st_size for path in files)
