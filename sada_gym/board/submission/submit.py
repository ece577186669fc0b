"""Makes an entry of the leaderboard from runs, from other entries, or from bare samples."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt
from pydantic import ValidationError

from sada_gym.board.results.entry import (
    METADATA_FILE,
    Entry,
    EntryResult,
    read_entry,
    write_metadata,
    write_results,
)
from sada_gym.board.results.models import MAX_SEEDS, EntryMetadata, Result, SeedResult
from sada_gym.board.submission.checks import check_entry, check_metadata, check_same_adversary
from sada_gym.board.submission.current import PAPER_BUDGETS, current_experiment, current_target
from sada_gym.board.submission.files import check_files
from sada_gym.board.submission.fragments import (
    ResultFragment,
    check_budget,
    join_fragments,
    read_fragments,
)
from sada_gym.board.submission.scoring import measure_samples
from sada_gym.errors import UserError, UserTypeError, check_integer
from sada_gym.evaluations import evaluation_seeds
from sada_gym.experiment.adversary import AdversarySpec, json_compatible
from sada_gym.experiment.algorithm import OnProgress, ignore_progress
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.files import (
    as_path,
    file_errors,
    first_error,
    read_array,
    restore_folder,
    write_folder,
)
from sada_gym.measures.collapse import collapse_flag
from sada_gym.parameters import Mu, validate_mu

ENTRIES = Path("leaderboard/entries")  #: Where the repository keeps the entries.
MAX_ARRAY_BYTES = 2**26  #: The most bytes of a file of samples.


def make_metadata(**fields: Any) -> EntryMetadata:
    """Make the metadata of an entry from the fields of `EntryMetadata`, or raise a UserError."""
    fields["authors"] = tuple(_as_list(fields.get("authors", ()), "authors"))
    try:
        return EntryMetadata(**fields)
    except ValidationError as error:
        raise UserError(
            f"Expected what an entry says of itself, but {first_error(error)}."
        ) from error


def submit(
    runs: Iterable[str | Path],
    metadata: EntryMetadata,
    *,
    rule: str | None = None,
    out: str | Path = ENTRIES,
    replace: bool = False,
) -> Entry:
    """Make an entry from runs, check it, and write it into the folder of entries.

    Args:
        runs: Folders that `attack` wrote, for several seeds and tracks, or folders of entries, such
            as a benchmark makes. All must have the same adversary, preset and options.
        metadata: See `make_metadata`.
        rule: The rule for the budget. None: `paper-budgets` for runs, and all rules for an entry.
        out: The folder of entries. If it has an entry of this name, the results are added to it.
        replace: Whether to replace results that the entry already has.

    Raises:
        UserError: If a run cannot be submitted, or the entry does not pass `check_entry`. Then
            nothing is changed.
    """
    fragments = [
        fragment
        for run in _as_list(runs, "runs")
        for fragment in read_fragments(as_path(run, "a run"), rule)
    ]
    if not fragments:
        raise UserError("Expected the folder of at least one run, got none. Name one.")
    folder, metadata = _prepared(metadata, fragments[0].command, out)
    return _put(folder, metadata, fragments, replace)


def submit_samples(
    samples: Iterable[npt.ArrayLike | str | Path],
    metadata: EntryMetadata,
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
    """Make an entry from samples that any program found, and write it into the folder of entries.

    Each array is evaluated once, on the test seeds of its seed. If there is a reference set, as
    many ideal samples are evaluated too.

    Args:
        samples: For each seed 0, 1, ... (M, d) in [-1, 1], or an NPY file; M is the `sample_size`.
        metadata: See `make_metadata`.
        track: The environment's id.
        adversary: The adversary's name.
        queries: The number of training queries that each seed spent.
        agent: The agent's name; None takes the default one.
        options: The adversary's options, as information for readers.
        rule: The rule for the budget, such as `paper-budgets` or `equal-queries`.
        workers: 1 evaluates in this process, more start that many worker processes.
        out: The folder of entries, see `submit`.
        replace: Whether to replace results that the entry already has.
        on_progress: Called with a `RunProgress` while evaluations are done.

    Raises:
        UserError: If an argument is bad, or the entry does not pass `check_entry`. Then nothing is
            changed.
    """
    given = _as_list(samples, "samples")
    if not 1 <= len(given) <= MAX_SEEDS:
        raise UserError(
            f"Expected the samples of 1 to {MAX_SEEDS} seeds, got {len(given)} arrays. Give one "
            "array for each seed."
        )
    check_integer("queries", queries, 0)
    for name, text in (("track", track), ("agent", agent or ""), ("rule", rule)):
        if not isinstance(text, str):
            raise UserTypeError(f"Expected the {name} to be a text, got {text!r}.")
    spec = AdversarySpec.of(adversary, options=options)
    spec = spec.model_copy(update={"options": json_compatible(spec.options)})
    experiment = current_experiment(track, agent, rule, spec)
    check_budget(f"the samples on {track}", int(queries), experiment, "queries")
    dimension = current_target(track, agent).dimension
    arrays = [
        _validate_samples(array, seed, experiment, dimension) for seed, array in enumerate(given)
    ]
    folder, metadata = _prepared(metadata, "", out)
    part = ResultFragment("the samples", EntryResult(Result.make(experiment, ()), {}))
    _read_kept(folder, part, {part.result.place}, replace)  # shows faults before long evaluations
    with experiment.target.open(workers=workers) as target:
        result = part.result
        for seed, mu in enumerate(arrays):
            seeds = evaluation_seeds(seed, "test", 0, len(mu))
            rows, measures = measure_samples(target, mu, seeds, seed=seed, on_progress=on_progress)
            flag = collapse_flag(mu)
            claims = SeedResult(
                seed=seed,
                queries=int(queries),
                measures=measures,
                flags=() if flag is None else (flag,),
                packages=packages(target.application, Ideal),  # needs no package, as arrays do
            )
            result = result.with_seed(claims, rows)
    return _put(folder, metadata, [ResultFragment(part.source, result)], replace)


def _as_list(values: Any, what: str) -> list[Any]:
    if isinstance(values, str | bytes | Path) or not isinstance(values, Iterable):
        raise UserTypeError(f"Expected a list of {what}, got {values!r}. Put it into a list.")
    return list(values)


def _validate_samples(samples: Any, seed: int, experiment: Experiment, dimension: int) -> Mu:
    source, track = f"the samples of seed {seed}", experiment.target.track
    count = experiment.protocol.samples
    if isinstance(samples, str | Path):
        source, samples = str(samples), read_array(Path(samples), MAX_ARRAY_BYTES)
    expected = (
        f"Expected {source} to be an array of shape ({count}, {dimension}), the M samples of d "
        f"parameters of {track}"
    )
    try:
        mu = validate_mu(samples, dimension)
    except UserError as error:
        raise UserError(f"{expected}: {error}") from error
    if len(mu) != count:
        raise UserError(f"{expected}, got {mu.shape}. Draw exactly M = {count} samples.")
    return mu


def _prepared(metadata: EntryMetadata, command: str, out: str | Path) -> tuple[Path, EntryMetadata]:
    """Return the folder of a new entry, and its metadata with what follows from other fields."""
    if not isinstance(metadata, EntryMetadata):
        raise UserTypeError(f"Expected metadata of make_metadata, got {metadata!r}.")
    title, command = metadata.title or metadata.name, metadata.command or command
    metadata = metadata.model_copy(update={"title": title, "command": command})
    folder = as_path(out, "the entries") / metadata.name
    check_metadata(metadata, folder / METADATA_FILE, submission=True)
    return folder, metadata


def _read_kept(
    folder: Path, new: ResultFragment, places: Collection[str], replace: bool
) -> list[EntryResult]:
    """Read the results of an entry that stay beside those in `places`, of the same adversary."""
    restore_folder(folder)
    if not folder.exists() and not folder.is_symlink():
        return []
    check_entry(folder, submission=False)
    kept = []
    for place, result in read_entry(folder).results.items():
        if place not in places:
            other = result.experiment.adversary
            check_same_adversary(new.source, new.result.experiment.adversary, folder, other)
            kept.append(result)
        elif not replace:
            raise UserError(
                f"Expected a new result, got {place}, which {folder} already has. Replace "
                "it by --replace, or give the entry another --name."
            )
    return kept


def _put(
    folder: Path, metadata: EntryMetadata, fragments: Sequence[ResultFragment], replace: bool
) -> Entry:
    """Write the new results elsewhere, check them, and put them in place with what stays."""

    def fill(place: Path, results: Iterable[EntryResult]) -> None:
        write_metadata(place, metadata)
        write_results(place, results)

    new = join_fragments(fragments)
    kept = _read_kept(folder, fragments[0], {result.place for result in new}, replace)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / metadata.name
        with file_errors("make the folder", made):
            made.mkdir()
        try:
            fill(made, new)
            check_entry(made)
            fill(made, [*kept, *new])
            check_files(made, submission=False)  # of the limits, which hold for all of them
        except UserError as error:
            # the user knows the place of the entry alone
            raise UserError(str(error).replace(str(made), str(folder))) from error
    with file_errors("make the folder", folder.parent):
        folder.parent.mkdir(parents=True, exist_ok=True)
    write_folder(folder, lambda beside: fill(beside, [*kept, *new]))
    return read_entry(folder)
