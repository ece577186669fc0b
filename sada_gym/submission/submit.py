"""Makes an entry of the leaderboard from runs, from other entries, or from bare samples."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy.typing as npt
from pydantic import ValidationError
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.errors import UserError, UserTypeError, check_integer
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.experiment.assemble import RunTarget, make_settings
from sada_gym.experiment.record import json_compatible
from sada_gym.experiment.run import OnProgress, Run, ignore_progress
from sada_gym.files import (
    as_path,
    file_errors,
    first_error,
    read_array,
    write_file,
    write_folder,
)
from sada_gym.measures.reference import load_reference
from sada_gym.parameters import Mu, validate_mu
from sada_gym.submission.checks import check_about, check_entry
from sada_gym.submission.entry import ABOUT_FILE, Entry, ResultFiles, read_entry, write_about
from sada_gym.submission.models import FORMAT, MAX_SEEDS, About, Identity, SeedResult
from sada_gym.submission.parts import (
    Part,
    Results,
    read_run,
    refuse_budget,
    refuse_other_adversary,
)
from sada_gym.submission.today import (
    PAPER_BUDGETS,
    Target,
    default_agent,
    find_target,
    today,
)

ENTRIES = Path("leaderboard/entries")
"""Where the repository keeps the entries."""

MAX_ARRAY_BYTES = 2**26
"""The most bytes of a file of samples."""


@dataclass(frozen=True)
class Credits:
    """Who submits an entry, and what it is called.

    Attributes:
        name: The name of the entry and of its folder: small letters, digits and `- + . _`.
        authors: Who made it.
        licence: The licence of its data, as SPDX names it.
        title: What the board calls it; empty takes the name.
        paper: The address of a paper.
        repository: The address of the code.
        command: How the results are made; empty takes the command of the first run.
    """

    name: str
    authors: Sequence[str]
    licence: str
    title: str = ""
    paper: str = ""
    repository: str = ""
    command: str = ""


def submit(
    runs: Iterable[str | Path],
    credits: Credits,
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
    results = Results()
    for run in _several(runs, "runs"):
        for part in read_run(as_path(run, "a run"), rule):
            results.add(part)
    if not results.parts:
        raise UserError("Expected the folder of at least one run, got none. Name one.")
    return _put(results, _Place.find(results.first, credits, out), replace)


def submit_samples(
    samples: Iterable[npt.ArrayLike | str | Path],
    credits: Credits,
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
    chosen = json_compatible(options or {})
    if agent is None:
        agent = default_agent(track)
    identity = today(track, agent, rule, adversary, None, chosen)
    refuse_budget(f"the samples on {track}", int(queries), identity, "queries")
    target = find_target(track, agent)
    arrays = [_checked_samples(one, i, identity, target) for i, one in enumerate(given)]
    place = _Place.find(Part("the samples", identity, (), {}), credits, out)
    place.keep([identity.stem], replace)  # what is wrong shows before hours of evaluation
    results = Results()
    evaluator = Evaluator(track, env_kwargs={"agent": agent} if agent else {}, workers=workers)
    now = True
    try:
        for seed, mu in enumerate(arrays):
            results.add(_evaluate(evaluator, target, identity, seed, mu, queries, on_progress))
        now = False
    finally:
        evaluator.close(now=now)
    return _put(results, place, replace)


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


def _checked_samples(given: Any, seed: int, identity: Identity, target: Target) -> Mu:
    """Read and check the samples of a seed."""
    source = f"the samples of seed {seed}"
    if isinstance(given, str | Path):
        source = str(given)
        given = read_array(Path(given), MAX_ARRAY_BYTES)
    try:
        mu = validate_mu(given, target.dimension)
    except UserError as error:
        raise UserError(
            f"Expected {source} to be an array of shape ({identity.samples}, {target.dimension}), "
            f"the M samples of d parameters of {identity.track}: {error}"
        ) from error
    if len(mu) != identity.samples:
        raise UserError(
            f"Expected {source} to be an array of shape ({identity.samples}, {target.dimension}), "
            f"the M samples of d parameters of {identity.track}, got {mu.shape}. Draw exactly "
            f"M = {identity.samples} samples."
        )
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
    evaluator: Evaluator,
    target: Target,
    identity: Identity,
    seed: int,
    mu: Mu,
    queries: int,
    on_progress: OnProgress,
) -> Part:
    """Evaluate and measure samples as a run does."""
    application = evaluator.application
    assert application is not None
    reference = load_reference(identity.track, application)
    settings = make_settings(
        RunTarget(identity.track, application, reference),
        _Given,
        _Given,
        preset=None,
        options={},
        budget=0,
        samples=identity.samples,
        seed=seed,
        label=identity.adversary,
    )
    run = Run(
        settings,
        _Given(mu),
        evaluator,
        fooling_set=target.fooling_set,
        ideal_set=target.ideal_set,
        on_progress=on_progress,
    )
    run.test()
    claimed = SeedResult.of(run.measure())
    # what was asked in training is not known
    claimed = claimed.model_copy(update={"queries": int(queries), "search": None})
    return Part(f"the samples of seed {seed}", identity, (claimed,), {seed: run.samples})


@dataclass(frozen=True)
class _Place:
    """Where an entry goes, and what it says of itself.

    Attributes:
        about: What it says of itself.
        folder: Its folder.
        first: One of its parts.
    """

    about: About
    folder: Path
    first: Part

    @classmethod
    def find(cls, first: Part, credits: Credits, out: str | Path) -> Self:
        """Find the place of an entry.

        Raises:
            UserError: If the credits do not fit.
        """
        identity = first.identity
        try:
            about = About(
                format=FORMAT,
                name=credits.name,
                title=credits.title or credits.name,
                authors=tuple(_several(credits.authors, "authors")),
                licence=credits.licence,
                paper=credits.paper,
                repository=credits.repository,
                command=credits.command or first.command,
                adversary=identity.adversary,
                preset=identity.preset,
                options=json.dumps(identity.options),
            )
        except ValidationError as error:
            raise UserError(
                f"Expected what an entry says of itself, but {first_error(error)}."
            ) from error
        folder = as_path(out, "the entries") / about.name
        check_about(about, folder / ABOUT_FILE, submission=True)
        return cls(about, folder, first)

    def keep(self, stems: Collection[str], replace: bool) -> dict[str, bytes]:
        """Read the files that stay of an entry that is there.

        Args:
            stems: What the names of the new results begin with.
            replace: Whether they may replace results that are there.

        Raises:
            UserError: If it is of another adversary, or has one of the results already.
        """
        folder = self.folder
        if not folder.exists() and not folder.is_symlink():
            return {}
        check_entry(folder, submission=False)
        kept: dict[str, bytes] = {}
        for stem, one in read_entry(folder).results.items():
            if stem in stems:
                if not replace:
                    raise UserError(
                        f"Expected a new result, got {stem}, which {folder} has already. Replace "
                        "it by --replace, or give the entry another --name."
                    )
                continue
            refuse_other_adversary(self.first, one.claimed.identity, str(folder))
            files = ResultFiles(folder, stem)
            for path in (files.claims, files.samples, files.verified):
                if path.exists():
                    with file_errors("read", path):
                        kept[path.name] = path.read_bytes()
        return kept


def _put(results: Results, place: _Place, replace: bool) -> Entry:
    """Write an entry beside its place, check it, and put it there together with what is there."""
    kept = place.keep(list(results.parts), replace)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / place.about.name
        with file_errors("make the folder", made):
            made.mkdir()
        write_about(made, place.about)
        results.write(made)
        try:
            check_entry(made)
        except UserError as error:
            # of the place that the user knows
            raise UserError(str(error).replace(str(made), str(place.folder))) from error
        files = {path.name: path.read_bytes() for path in sorted(made.iterdir())}

    def fill(beside: Path) -> None:
        for name, content in (kept | files).items():
            write_file(beside / name, content)

    with file_errors("make the folder", place.folder.parent):
        place.folder.parent.mkdir(parents=True, exist_ok=True)
    write_folder(place.folder, fill)
    return read_entry(place.folder)
