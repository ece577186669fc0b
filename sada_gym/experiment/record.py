"""What a run of Algorithm 1 writes down: its settings at the start, its result at the end."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import Self

from sada_gym.application import Application
from sada_gym.errors import FileError, StoreError, UserError, UserTypeError
from sada_gym.evaluation.store import Context, EvaluationStore
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.measure import Distances, Measures, Search
from sada_gym.files import OneLine, Strict, read_arrays, read_model, write_file, write_model
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.failure_regions import FailureRegions, failure_regions
from sada_gym.measures.reference import Reference

SETTINGS_FILE = "attack.json"
RESULT_FILE = "result.json"
SAMPLES_FILE = "samples.npz"
STORE_FILE = "run.sqlite"
ADVERSARY_FOLDER = "adversary"


class ReferenceSummary(Strict):
    """The reference set that a run is measured against.

    Attributes:
        sha256: The SHA-256 of its file.
        points: The number of its points, which are uniform in the box.
        fooling: How many of them belong to the fooling set.
        uniform_rate: Share of all their evaluations that fooled: the AFR of uniform samples.
    """

    sha256: str
    points: int
    fooling: int
    uniform_rate: float

    @classmethod
    def of(cls, reference: Reference) -> Self:
        """Describe a reference set."""
        entry = reference.entry
        return cls(
            sha256=entry.sha256,
            points=entry.points,
            fooling=int(reference.fooling.sum()),
            uniform_rate=reference.uniform_rate,
        )

    @property
    def usable(self) -> bool:
        """Whether half of the fooling set has enough points to measure coverage with."""
        return self.fooling // 2 > NEAREST


class RunKey(Strict):
    """The name of a run: one adversary on one track, for one seed.

    Attributes:
        table: The benchmark's table; empty for a single attack.
        track: The environment's id.
        agent: What the agent under test is called.
        label: What the adversary is called in reports.
        seed: The seed of the adversary and of all evaluation seeds.
    """

    table: str = ""
    track: str
    agent: str
    label: str
    seed: int

    def __str__(self) -> str:
        """Name the run for people."""
        agent = f" against {self.agent}" if self.agent else ""
        table = f", table {self.table}" if self.table else ""
        return f"{self.label} on {self.track}{agent}, seed {self.seed}{table}"


class RunSettings(RunKey):
    """Everything that decides a run's result.

    Attributes:
        adversary: The adversary's registered name, `module:Class`, or `ideal`.
        preset: The named set of options it starts from, if any.
        options: Its other options.
        resolved: All its options, defaults included: a run with other defaults is another run.
        budget: The number of training queries that it may spend.
        samples: The number of test samples (M in the paper).
        images: The number of samples whose nearest queries are compared as images.
        application: The application's name.
        version: The application's version.
        application_settings: The application's resolved keywords.
        fingerprint: The agent's SHA-256.
        reference: The reference set that coverage is measured by; None where there is none.
        packages: Versions of what takes part: a run is not resumed with others.
    """

    adversary: str
    preset: str | None
    options: dict[str, Any]
    resolved: dict[str, Any]
    budget: int
    samples: int
    images: int = 0
    application: str
    version: int
    application_settings: dict[str, Any]
    fingerprint: str
    reference: ReferenceSummary | None = None
    packages: dict[str, str]


class RunReport(Measures):
    """The contents of result.json: the measures of a run, and its settings.

    It holds no wall-clock times: a resumed run's file is the same.

    Attributes:
        settings: The run's settings.
        fooling_threshold: The agent is fooled where Q <= this.
        nearest_fooling_query: Distances from the samples to the nearest training query that fooled
            the agent; None where none did.
        search: What the training queries found.
        seeds: How the seeds follow from the settings' seed.
        flags: What a reader must know, such as that no training query fooled.
        where: Where the samples that fooled lie; None in files of earlier versions.
    """

    settings: RunSettings
    fooling_threshold: float
    nearest_fooling_query: Distances | None
    search: Search
    seeds: dict[str, str | int]
    flags: tuple[OneLine, ...]
    where: FailureRegions | None = None

    def measures(self) -> Measures:
        """Give the measures alone."""
        return Measures(**{name: getattr(self, name) for name in Measures.model_fields})


class RunFailure(Strict):
    """A run of a benchmark whose adversary could not do its work, and why.

    Attributes:
        settings: The run's settings.
        fooling_threshold: The agent is fooled where Q <= this.
        error: The message of the adversary's `AdversaryError`.
    """

    settings: RunSettings
    fooling_threshold: float
    error: str


def write_samples(path: Path, samples: Evaluations) -> None:
    """Write test samples as NPZ: mu (n, d) float32, score (n,) float64, seed (n,) int64."""
    buffer = io.BytesIO()
    np.savez(buffer, mu=samples.mu, score=samples.score, seed=samples.seed)
    write_file(path, buffer.getvalue())


def read_samples(path: Path) -> Evaluations:
    """Read test samples that `write_samples` wrote.

    Raises:
        FileError: If the file cannot be read or does not hold such samples.
    """
    arrays = read_arrays(path, {"mu": ("f4", 2), "score": ("f8", 1), "seed": ("i8", 1)})
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise FileError(
            f"Expected as many mu as scores and seeds in {path}, got {counts}. "
            "Restore the file, or make it anew."
        )
    return Evaluations(arrays["mu"], arrays["score"], arrays["seed"])


def json_compatible(options: Mapping[str, Any]) -> dict[str, Any]:
    """Copy an adversary's options as JSON would hold them.

    Raises:
        TypeError: If they cannot be written as JSON.
    """
    try:
        copied: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise UserTypeError(
            f"Expected options that can be written as JSON, got {dict(options)!r} ({error}). "
            "Give numbers, strings, lists, None."
        ) from error
    return copied


@dataclass(frozen=True)
class Claim:
    """A folder that is a run's own.

    Attributes:
        folder: The folder.
        made: What claiming it made: folders, the innermost first. None where it held the run.
    """

    folder: Path
    made: tuple[Path, ...] | None

    def release(self) -> None:
        """Take back a claim whose run made no evaluation, so that nothing of it is left."""
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


def refuse_taken(folder: Path, *, resume: bool) -> None:
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


def claim_folder(folder: Path, settings: RunSettings, *, resume: bool) -> Claim:
    """Make a folder an attack's own by writing its settings there, or find them there.

    Raises:
        ValueError: If it holds another run, or the same one and `resume` is not set. Nothing is
            changed then.
    """
    refuse_taken(folder, resume=resume)
    path = folder / SETTINGS_FILE
    if path.exists():
        refuse_other(
            f"the settings that the run in {folder} was started with",
            read_model(path, RunSettings).model_dump(mode="json"),
            settings.model_dump(mode="json"),
        )
        return Claim(folder, None)
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    claim = Claim(folder, tuple(missing))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_model(path, settings)
    except BaseException:
        claim.release()
        raise
    return claim


def read_finished(
    folder: Path, settings: RunSettings, application: Application
) -> tuple[RunReport, Evaluations, Evaluations] | None:
    """Read what a finished run left: its report, its test samples and its training queries.

    Args:
        folder: The run's folder.
        settings: The run's settings.
        application: What it attacked.

    Returns:
        None where the run is not finished, or one of its files is missing or damaged. To go on with
        it makes that file anew.

    Raises:
        StoreError: If another process has the run's store open.
    """
    if not all((folder / name).exists() for name in (RESULT_FILE, SAMPLES_FILE, STORE_FILE)):
        return None
    if not (folder / ADVERSARY_FOLDER).is_dir():
        return None
    try:
        report = read_model(folder / RESULT_FILE, RunReport)
        samples = read_samples(folder / SAMPLES_FILE)
    except FileError:
        return None
    shape = (settings.samples, len(application.parameters))
    if report.settings != settings or samples.mu.shape != shape:
        return None
    seeds = evaluation_seeds(settings.seed, "train", 0, report.search.queries)
    mu, score = np.zeros((0, shape[1]), np.float32), np.zeros(0)
    if seeds:
        with EvaluationStore(folder / STORE_FILE) as store:
            known = store.evaluations(store.context(Context.of(application)), seeds)
        if known is None:
            return None
        mu, score = known
    if report.where is None:
        failures = samples.mu[samples.fooled(report.fooling_threshold)]
        report = report.model_copy(
            update={"where": failure_regions(application.parameters, failures)}
        )
    return report, samples, Evaluations(mu, score, np.array(seeds, np.int64))


def differences(old: Mapping[str, object], new: Mapping[str, object]) -> list[str]:
    """Name what differs between two records, down to single entries."""
    found = []
    for name in sorted({*old, *new}):
        before, now = old.get(name), new.get(name)
        if isinstance(before, Mapping) and isinstance(now, Mapping):
            found += [f"{name}.{change}" for change in differences(before, now)]
        elif before != now:
            found.append(f"{name} was {before!r} and is {now!r}")
    return found


def refuse_other(
    expected: str,
    old: Mapping[str, object],
    new: Mapping[str, object],
    mend: str = "Give the same ones, or name another folder.",
) -> None:
    """Refuse to mix records that differ.

    Args:
        expected: What was expected, as in "the settings that ...".
        old: The record that is there.
        new: The record that was asked for.
        mend: What the user can do.

    Raises:
        ValueError: If they differ; it names every entry that does.
    """
    changes = differences(old, new)
    if changes:
        raise UserError(f"Expected {expected}, got others: {'; '.join(changes)}. {mend}")
