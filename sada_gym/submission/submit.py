"""Makes an entry of the leaderboard from runs, from other entries, or from bare samples."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy.typing as npt
from pydantic import ValidationError
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.errors import UserError, UserTypeError, check_integer
from sada_gym.experiment.adversary import AdversarySpec, json_compatible
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import Experiment, RunSettings
from sada_gym.experiment.run import OnProgress, Run, ignore_progress
from sada_gym.experiment.target import OpenTarget
from sada_gym.files import as_path, file_errors, first_error, read_array, write_folder
from sada_gym.parameters import Mu, validate_mu
from sada_gym.results.entry import (
    METADATA_FILE,
    Entry,
    EntryResult,
    read_entry,
    write_metadata,
    write_results,
)
from sada_gym.results.models import MAX_SEEDS, EntryMetadata, Result, SeedResult
from sada_gym.submission.checks import check_entry, check_metadata
from sada_gym.submission.current import (
    PAPER_BUDGETS,
    current_experiment,
    current_target,
    default_agent,
)
from sada_gym.submission.parts import Part, Parts, check_budget, check_same_adversary, read_run

ENTRIES = Path("leaderboard/entries")
"""Where the repository keeps the entries."""

MAX_ARRAY_BYTES = 2**26
"""The most bytes of a file of samples."""


def credit(**fields: Any) -> EntryMetadata:
    """Say who submits an entry, and what it is called.

    Args:
        fields: See `EntryMetadata`.

    Raises:
        UserError: If one of them does not fit.
    """
    fields["authors"] = tuple(_several(fields.get("authors", ()), "authors"))
    try:
        return EntryMetadata(**fields)
    except ValidationError as error:
        raise UserError(
            f"Expected what an entry says of itself, but {first_error(error)}."
        ) from error


def submit(
    runs: Iterable[str | Path],
    credits: EntryMetadata,
    *,
    rule: str | None = None,
    out: str | Path = ENTRIES,
    replace: bool = False,
) -> Entry:
    """Make an entry of runs, check it, and put it in place.

    Args:
        runs: Folders that `attack` wrote, of several seeds and tracks, or entries' folders, such as
            a benchmark makes. All are of one adversary with one preset and one set of options.
        credits: Who submits it, and what it is called.
        rule: The rule for the budget. None takes `paper-budgets` for runs, and all of an entry.
        out: The folder of the entries. Results join an entry of that name that is there.
        replace: Whether to replace results that the entry has already.

    Raises:
        UserError: If a run cannot take part, or the entry does not pass `check_entry`. Nothing is
            changed then.
    """
    parts = Parts()
    for run in _several(runs, "runs"):
        for part in read_run(as_path(run, "a run"), rule):
            parts.add(part)
    if not parts.by_place:
        raise UserError("Expected the folder of at least one run, got none. Name one.")
    return _put(parts, _Place.find(parts.first, credits, out), replace)


def submit_samples(
    samples: Iterable[npt.ArrayLike | str | Path],
    credits: EntryMetadata,
    *,
    track: str,
    adversary: str,
    queries: int,
    agent: str | None = None,
    options: Mapping[str, Any] | None = None,
    rule: str = PAPER_BUDGETS,
    workers: int = 1,
    out: str | Path = ENTRIES,
    replace: bool = False,
    on_progress: OnProgress = ignore_progress,
) -> Entry:
    """Make an entry of samples that any program found, and put it in place.

    Each array is evaluated once, on the test seeds of its seed, and so are as many ideal samples
    where there is a reference set.

    Args:
        samples: For each seed 0, 1, ... the M samples, (M, d) in [-1, 1], or an NPY file of them.
        credits: Who submits it, and what it is called.
        track: The environment's id.
        adversary: What its authors call the adversary.
        queries: The number of training queries that each seed spent.
        agent: The agent's name; None takes the default one.
        options: The adversary's options, for readers.
        rule: The rule for the budget.
        workers: 1 evaluates in this process, more evaluate in as many others.
        out: The folder of the entries. Results join an entry of that name that is there.
        replace: Whether to replace results that the entry has already.
        on_progress: Called as evaluations are done.

    Raises:
        UserError: If an argument is bad, or the entry does not pass `check_entry`. Nothing is
            changed then.
    """
    given = _several(samples, "samples")
    if not 1 <= len(given) <= MAX_SEEDS:
        raise UserError(
            f"Expected the samples of 1 to {MAX_SEEDS} seeds, got {len(given)} arrays. Give one "
            "array for each seed."
        )
    check_integer("queries", queries, 0)
    if agent is None:
        agent = default_agent(track)
    spec = AdversarySpec(name=adversary, options=json_compatible(options or {}))
    experiment = current_experiment(track, agent, rule, spec)
    check_budget(f"the samples on {track}", int(queries), experiment, "queries")
    dimension = current_target(track, agent).dimension
    arrays = [
        _validate_samples(array, seed, experiment, dimension) for seed, array in enumerate(given)
    ]
    first = Part("the samples", EntryResult(Result.make(experiment, ()), {}))
    place = _Place.find(first, credits, out)
    place.keep([first.result.place], replace)  # what is wrong shows before hours of evaluation
    parts = Parts()
    with experiment.target.open(workers=workers) as target:
        for seed, mu in enumerate(arrays):
            parts.add(_evaluate(target, experiment.at(seed), mu, queries, on_progress))
    return _put(parts, place, replace)


def parse_options(text: str) -> dict[str, Any]:
    """Read an adversary's options from JSON.

    Raises:
        UserError: If the text is no JSON object.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise UserError(
            f'Expected options that are a JSON object, such as {{"trials": 1000}}, got {text!r}.'
        )
    return found


def _several(given: Any, what: str) -> list[Any]:
    if isinstance(given, str | Path) or not isinstance(given, Iterable):
        raise UserTypeError(f"Expected a list of {what}, got {given!r}. Put it into a list.")
    return list(given)


def _validate_samples(given: Any, seed: int, experiment: Experiment, dimension: int) -> Mu:
    """Read and check the samples of a seed."""
    source, track = f"the samples of seed {seed}", experiment.target.track
    count = experiment.protocol.samples
    if isinstance(given, str | Path):
        source = str(given)
        given = read_array(Path(given), MAX_ARRAY_BYTES)
    expected = (
        f"Expected {source} to be an array of shape ({count}, {dimension}), the M samples of d "
        f"parameters of {track}"
    )
    try:
        mu = validate_mu(given, dimension)
    except UserError as error:
        raise UserError(f"{expected}: {error}") from error
    if len(mu) != count:
        raise UserError(f"{expected}, got {mu.shape}. Draw exactly M = {count} samples.")
    return mu


class _Given(Adversary):
    """Draws the samples that a user brought."""

    name: ClassVar[str] = "given"
    packages = ()

    def __init__(self, mu: Mu) -> None:
        super().__init__(mu.shape[1])
        self._mu = mu

    def train(self, oracle: Query) -> None:
        """Learn nothing."""

    def sample(self, n: int) -> Mu:
        """Give the samples, (n, d)."""
        return self._mu[:n]

    def save(self, folder: Path) -> None:
        """Do not save it."""
        raise NotImplementedError

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Do not load it."""
        raise NotImplementedError


def _evaluate(
    target: OpenTarget, experiment: Experiment, mu: Mu, queries: int, on_progress: OnProgress
) -> Part:
    """Evaluate and measure samples as a run does."""
    settings = RunSettings(
        experiment=experiment,
        label=experiment.adversary.name,
        packages=packages(target.application, _Given),
    )
    run = Run(
        settings,
        _Given(mu),
        target.evaluator,
        fooling_set=target.fooling_set,
        ideal_set=target.ideal_set,
        on_progress=on_progress,
    )
    run.test()
    # what was asked in training is not known
    claims = SeedResult.of(run.measure()).model_copy(
        update={"queries": int(queries), "search": None}
    )
    result = EntryResult(Result.make(experiment, [claims]), {claims.seed: run.samples})
    return Part(f"the samples of seed {claims.seed}", result)


@dataclass(frozen=True)
class _Place:
    """Where an entry goes, and what it says of itself.

    Attributes:
        metadata: What it says of itself.
        folder: Its folder.
        first: One of its parts.
    """

    metadata: EntryMetadata
    folder: Path
    first: Part

    @classmethod
    def find(cls, first: Part, credits: EntryMetadata, out: str | Path) -> Self:
        """Find the place of an entry.

        Raises:
            UserError: If the credits do not fit.
        """
        metadata = credits.model_copy(
            update={
                "title": credits.title or credits.name,
                "command": credits.command or first.command,
            }
        )
        folder = as_path(out, "the entries") / metadata.name
        check_metadata(metadata, folder / METADATA_FILE, submission=True)
        return cls(metadata, folder, first)

    def keep(self, places: Collection[str], replace: bool) -> list[EntryResult]:
        """Read the results that stay of an entry that is there.

        Args:
            places: The places of the new results.
            replace: Whether they may replace results that are there.

        Raises:
            UserError: If it is of another adversary, or has one of the results already.
        """
        folder = self.folder
        if not folder.exists() and not folder.is_symlink():
            return []
        check_entry(folder, submission=False)
        kept = []
        for place, result in read_entry(folder).results.items():
            if place not in places:
                check_same_adversary(self.first, result.claimed.experiment.adversary, str(folder))
                kept.append(result)
            elif not replace:
                raise UserError(
                    f"Expected a new result, got {place}, which {folder} has already. Replace "
                    "it by --replace, or give the entry another --name."
                )
        return kept


def _put(parts: Parts, place: _Place, replace: bool) -> Entry:
    """Write an entry beside its place, check it, and put it there together with what is there."""
    kept = place.keep(list(parts.by_place), replace)
    new = list(parts.results())
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / place.metadata.name
        with file_errors("make the folder", made):
            made.mkdir()
        write_metadata(made, place.metadata)
        write_results(made, new)
        try:
            check_entry(made)
        except UserError as error:
            # of the place that the user knows
            raise UserError(str(error).replace(str(made), str(place.folder))) from error

    def fill(beside: Path) -> None:
        write_metadata(beside, place.metadata)
        write_results(beside, [*kept, *new])

    with file_errors("make the folder", place.folder.parent):
        place.folder.parent.mkdir(parents=True, exist_ok=True)
    write_folder(place.folder, fill)
    return read_entry(place.folder)
