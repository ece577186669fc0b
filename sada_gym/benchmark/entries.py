"""A benchmark's results are entries of the leaderboard: what they lack, and how a run is added."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from sada_gym.benchmark.folder import RunDone
from sada_gym.benchmark.suite import CONTENDERS, Contender
from sada_gym.errors import UserError
from sada_gym.experiment.record import RunSettings
from sada_gym.files import file_errors, first_error
from sada_gym.submission.entry import (
    ABOUT_FILE,
    ResultFiles,
    read_about,
    write_about,
    write_result,
)
from sada_gym.submission.models import FORMAT, About, Identity, Result, SeedResult, entry_name

if TYPE_CHECKING:
    from sada_gym.benchmark.plan import Plan

AUTHORS, LICENCE = ("sada_gym's developers",), "MIT"
"""Who made the entries of our own contenders, and the licence of their data."""


@dataclass(frozen=True)
class Missing:
    """What a plan asks for and the entries lack.

    Attributes:
        runs: The runs that are yet to be made.
        lacking: The number of results that lack some of the plan's seeds, or all.
        outdated: The number of results that are there, but of another identity: the track, the
            agent, the adversary's options, the budget or the number of samples have changed.
    """

    runs: tuple[RunSettings, ...]
    lacking: int
    outdated: int


def about_of(contender: Contender) -> About:
    """Write down what the entry of a contender says of it.

    Raises:
        UserError: If its label gives no name for a folder, or one of its parts does not fit.
    """
    ours = contender in CONTENDERS
    try:
        return About(
            format=FORMAT,
            name=entry_name(contender.label),
            title=contender.label,
            authors=AUTHORS if ours else (),
            licence=LICENCE if ours else "",
            command=shlex.join(["sada-gym", "benchmark", "-a", contender.label]) if ours else "",
            adversary=contender.adversary,
            preset=contender.preset,
            options=json.dumps(contender.options, sort_keys=True),
        )
    except (ValidationError, TypeError, ValueError) as error:
        reason = first_error(error) if isinstance(error, ValidationError) else str(error)
        raise UserError(
            f"Expected a contender that an entry can describe, got {contender.label!r} ({reason}). "
            "Give it a short label, and options that can be written as JSON."
        ) from error


def find_missing(entries: Path, plan: Plan) -> Missing:
    """Find the runs of a plan that are yet to be made.

    A run is there where its seed is in a result of its identity. Seeds, results and entries that
    the plan does not name are left alone.

    Args:
        entries: The folder of the entries.
        plan: All runs.

    Raises:
        FileError: If a file of an entry that the plan names cannot be read.
        UserError: If an entry that the plan names is of another adversary.
    """
    for about in plan.abouts.values():
        _refuse_other_entry(entries / about.name, about)
    there: dict[ResultFiles, tuple[str, set[int]] | None] = {}
    runs: list[RunSettings] = []
    lacking, outdated = set[ResultFiles](), set[ResultFiles]()
    for group in plan.groups:
        for run in group.runs:
            identity = group.identity(run)
            files = ResultFiles(entries / plan.abouts[run.label].name, identity.stem)
            if files not in there:
                there[files] = _seeds_in(files)
            found = there[files]
            if found is not None and found[0] == identity.sha256:
                if run.seed in found[1]:
                    continue
                lacking.add(files)
            else:
                (lacking if found is None else outdated).add(files)
            runs.append(run)
    return Missing(tuple(runs), len(lacking), len(outdated))


def _seeds_in(files: ResultFiles) -> tuple[str, set[int]] | None:
    """Give the identity's hash and the seeds of a result; None where there is no result."""
    if not files.claims.exists():
        return None
    result, _ = files.read()
    return result.identity_sha256, {one.seed for one in result.seeds}


def add_run(entries: Path, about: About, identity: Identity, done: RunDone) -> None:
    """Add a finished run to its result, and make the entry and the result where they are missing.

    A result of another identity is outdated: one with this seed alone takes its place.

    Args:
        entries: The folder of the entries.
        about: What the entry says of the contender.
        identity: The identity of the result.
        done: The finished run.

    Raises:
        FileError: If a file cannot be read or written.
    """
    folder = entries / about.name
    with file_errors("make the folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    _update_about(folder, about)
    files = ResultFiles(folder, identity.stem)
    seeds, samples = {}, {}
    if files.claims.exists():
        result, held = files.read()
        if result.identity_sha256 == identity.sha256:
            seeds, samples = {one.seed: one for one in result.seeds}, held
    seed = done.result.settings.seed
    seeds[seed] = SeedResult.of(done.result)
    samples.pop(seed, None)
    if done.samples is not None:
        samples[seed] = done.samples
    write_result(folder, Result.make(identity, seeds.values()), samples)


def _update_about(folder: Path, about: About) -> None:
    """Write entry.toml, or correct the adversary's options in the one that is there."""
    if (folder / ABOUT_FILE).exists():
        known = read_about(folder)
        about = known.model_copy(update={"preset": about.preset, "options": about.options})
        if about == known:
            return
    write_about(folder, about)


def _refuse_other_entry(folder: Path, about: About) -> None:
    if not (folder / ABOUT_FILE).exists():
        return
    known = read_about(folder)
    if known.adversary != about.adversary:
        raise UserError(
            f"Expected the entry in {folder} to be of the adversary {about.adversary}, got one of "
            f"{known.adversary}. Give the contender another label, or name another folder for the "
            "entries."
        )
