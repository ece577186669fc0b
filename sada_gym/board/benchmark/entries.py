"""A benchmark's results are entries of the leaderboard: what they lack, and how a run is added."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

from sada_gym.board.benchmark.folder import RunDone
from sada_gym.board.benchmark.plan import BenchmarkPlan
from sada_gym.board.results.entry import (
    METADATA_FILE,
    EntryResult,
    GroupFiles,
    group_files,
    write_metadata,
)
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult
from sada_gym.errors import UserError
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import RunSettings
from sada_gym.foundations.files import file_errors


@dataclass(frozen=True)
class Missing:
    """What a plan asks for and the entries lack.

    Attributes:
        runs: The runs to make.
        lacking: The number of results in which some seeds are missing, or all.
        outdated: The number of results of another experiment: the track, the agent, the
            adversary's options, the budget or the number of samples have changed.
    """

    runs: tuple[RunSettings, ...]
    lacking: int
    outdated: int


def find_missing(entries: Path, plan: BenchmarkPlan) -> Missing:
    """Find the runs of a plan that are yet to be made.

    A run is there where its seed is in a result of its experiment. Seeds, results and entries that
    the plan does not name are left alone.

    Raises:
        FileError: If a file of an entry that the plan names cannot be read.
        UserError: If an entry that the plan names is of another adversary.
    """
    claims: dict[GroupFiles, tuple[Result, ...]] = {}
    for label, metadata in plan.metadata.items():
        claims |= _read_claims(entries / metadata.name, plan.suite.adversaries[label])
    files_read: dict[GroupFiles, dict[str, EntryResult]] = {}
    runs: list[RunSettings] = []
    lacking, outdated = set[tuple[Path, str]](), set[tuple[Path, str]]()
    for run in plan.runs:
        files = GroupFiles(entries / plan.metadata[run.label].name, run.experiment.group)
        if files not in files_read:
            files_read[files] = files.read(claims.get(files))
        place = run.experiment.place
        known = files_read[files].get(place)
        if known is None or known.experiment == run.experiment.at(None):
            if known is not None and run.seed in {claims.seed for claims in known.claimed.seeds}:
                continue
            lacking.add((files.claims, place))
        else:
            outdated.add((files.claims, place))
        runs.append(run)
    return Missing(tuple(runs), len(lacking), len(outdated))


def add_run(entries: Path, metadata: EntryMetadata, done: RunDone) -> None:
    """Add a finished run to its result, and make the entry and the result where they are missing.

    A result of another experiment is outdated: one with this seed alone takes its place. A file
    that cannot be read or written is a FileError.
    """
    folder = entries / metadata.name
    with file_errors("make the folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    if not (folder / METADATA_FILE).exists():
        write_metadata(folder, metadata)
    settings = done.result.settings
    files = GroupFiles(folder, settings.experiment.group)
    results = files.read()
    experiment = settings.experiment.at(None)
    result = results.get(experiment.place)
    if result is None or result.experiment != experiment:
        result = EntryResult(Result.make(experiment, ()), {})
    result = result.with_seed(SeedResult.of(done.result), done.samples)
    files.write((results | {result.place: result}).values())


def _read_claims(folder: Path, adversary: AdversarySpec) -> dict[GroupFiles, tuple[Result, ...]]:
    """Read what an entry claims, if it is there, all of it of this adversary."""
    if not (folder / METADATA_FILE).exists():
        return {}
    claims = {files: files.read_claims() for files in group_files(folder)}
    for result in itertools.chain.from_iterable(claims.values()):
        known = result.experiment.adversary.name
        if known != adversary.name:
            raise UserError(
                f"Expected the entry in {folder} to be of the adversary {adversary.name}, got one "
                f"of {known}. Give the adversary another label, or name another folder for the "
                "entries."
            )
    return claims
