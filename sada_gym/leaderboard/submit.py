"""Makes an entry of the leaderboard from runs, from other entries, or from bare samples."""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy.typing as npt
from pydantic import ValidationError
from typing_extensions import Self

from sada_gym import agents
from sada_gym.adversaries.base import Adversary, Query
from sada_gym.envs.catalogue import find_card
from sada_gym.errors import UserError, UserTypeError, refuse_number
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Evaluations
from sada_gym.files import (
    as_path,
    file_errors,
    first_error,
    read_array,
    read_model,
    write_file,
    write_folder,
)
from sada_gym.leaderboard.checks import check_entry
from sada_gym.leaderboard.entry import (
    ABOUT_FILE,
    CLAIMS,
    FORMAT,
    MAX_SEEDS,
    SAMPLES,
    VERIFIED,
    About,
    Entry,
    Identity,
    Result,
    SeedResult,
    read_entry,
    write_about,
    write_result,
)
from sada_gym.leaderboard.today import (
    PAPER_BUDGETS,
    RULES,
    Target,
    board_tracks,
    default_agent,
    find_target,
    today,
)
from sada_gym.measures.reference import load_reference
from sada_gym.parameters import Mu, validate_mu
from sada_gym.runs.assemble import RunTarget, make_settings
from sada_gym.runs.record import (
    RESULT_FILE,
    SAMPLES_FILE,
    SETTINGS_FILE,
    RunReport,
    RunSettings,
    differences,
    json_compatible,
    read_samples,
)
from sada_gym.runs.run import OnProgress, Run, ignore_progress

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


@dataclass(frozen=True, eq=False)
class _Part:
    """Some seeds of one result."""

    source: str
    identity: Identity
    seeds: tuple[SeedResult, ...]
    samples: Mapping[int, Evaluations]


@dataclass(eq=False)
class _Results:
    """The results of one adversary, put together from parts."""

    parts: dict[str, list[_Part]] = field(default_factory=dict)

    @property
    def first(self) -> Identity:
        """The identity of the first part."""
        return next(iter(self.parts.values()))[0].identity

    def add(self, part: _Part) -> None:
        """Add a part.

        Raises:
            UserError: If it is of another adversary, or of another result of the same name, or has
                a seed that is there already.
        """
        if self.parts:
            _refuse_other_adversary(part, self.first)
        known = self.parts.setdefault(part.identity.stem, [])
        for other in known:
            changes = differences(
                other.identity.model_dump(mode="json"), part.identity.model_dump(mode="json")
            )
            if changes:
                raise UserError(
                    f"Expected {part.source} to differ from {other.source} in its seed alone, got "
                    f"other settings: {'; '.join(changes)}. Submit them as two entries."
                )
            twice = {one.seed for one in other.seeds} & {one.seed for one in part.seeds}
            if twice:
                raise UserError(
                    f"Expected each seed of {part.identity.stem} once, got {min(twice)} in both "
                    f"{other.source} and {part.source}. Name one of them, or attack with another "
                    "--seed."
                )
        known.append(part)

    def write(self, folder: Path) -> None:
        """Write all results."""
        for parts in self.parts.values():
            seeds = [seed for part in parts for seed in part.seeds]
            samples = {seed: one for part in parts for seed, one in part.samples.items()}
            write_result(folder, _make_result(parts[0].identity, seeds), samples)


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
    results = _Results()
    command = credits.command
    for run in _several(runs, "runs"):
        folder = as_path(run, "a run")
        for part in _read_run(folder, rule):
            results.add(part)
        if not command and (folder / RESULT_FILE).exists():
            command = _command(read_model(folder / RESULT_FILE, RunReport).settings)
    if not results.parts:
        raise UserError("Expected the folder of at least one run, got none. Name one.")
    return _put(results, credits, command, as_path(out, "the entries"), replace)


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
    refuse_number("queries", queries, 0)
    chosen = json_compatible(options or {})
    if agent is None:
        agent = default_agent(track)
    identity = today(track, agent, rule, adversary, None, chosen)
    _refuse_budget(f"the samples on {track}", int(queries), identity, "queries")
    target = find_target(track, agent)
    arrays = [_checked_samples(one, i, identity, target) for i, one in enumerate(given)]
    results = _Results()
    evaluator = Evaluator(track, env_kwargs={"agent": agent} if agent else {}, workers=workers)
    now = True
    try:
        for seed, mu in enumerate(arrays):
            results.add(_evaluate(evaluator, target, identity, seed, mu, queries, on_progress))
        now = False
    finally:
        evaluator.close(now=now)
    return _put(results, credits, credits.command, as_path(out, "the entries"), replace)


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


def _read_run(folder: Path, rule: str | None) -> list[_Part]:
    if (folder / ABOUT_FILE).exists():
        return _read_entry(folder, rule)
    if (folder / RESULT_FILE).exists():
        return [_read_attack(folder, rule or PAPER_BUDGETS)]
    if (folder / SETTINGS_FILE).exists():
        raise UserError(
            f"Expected a finished run, got {folder}, which was stopped. Go on with it by "
            "sada-gym attack --resume."
        )
    raise UserError(
        f"Expected the folder of a run, with {RESULT_FILE}, or of an entry, with {ABOUT_FILE}; got "
        f"{folder}, which holds neither. A benchmark's entries are in its folder `entries`."
    )


def _read_entry(folder: Path, rule: str | None) -> list[_Part]:
    check_entry(folder, submission=False)
    results = read_entry(folder).results
    parts = [
        _Part(f"{folder / stem}{CLAIMS}", one.claimed.identity, one.claimed.seeds, one.samples)
        for stem, one in results.items()
        if rule in (None, one.claimed.identity.rule)
    ]
    if not parts:
        raise UserError(
            f"Expected results by the rule {rule} in {folder}, got others. Leave --rule out to "
            "take all of them."
        )
    return parts


def _read_attack(folder: Path, rule: str) -> _Part:
    report = read_model(folder / RESULT_FILE, RunReport)
    samples, settings = read_samples(folder / SAMPLES_FILE), report.settings
    track = _board_track(folder, settings)
    identity = today(
        track,
        settings.agent,
        rule,
        settings.adversary,
        settings.preset,
        settings.options,
        resolved=settings.resolved,
    )
    made = Identity.of(settings, rule, report.fooling_threshold)
    free = {"track": track, "budget": identity.budget}  # checked apart
    changes = differences(
        made.model_copy(update=free).model_dump(mode="json"), identity.model_dump(mode="json")
    )
    if changes:
        raise UserError(
            f"Expected the run in {folder} to be of {track} as the leaderboard has it today, but: "
            f"{'; '.join(changes)}. Attack again with these settings."
        )
    _refuse_budget(f"the run in {folder}", settings.budget, identity, "--budget")
    seed = SeedResult.of(report)
    return _Part(str(folder), identity, (seed,), {seed.seed: samples})


def _board_track(folder: Path, settings: RunSettings) -> str:
    """Find the track that a run was made on, which may have been named by a general id."""
    if settings.track in board_tracks():
        return settings.track
    card = find_card(settings.application)
    if card is None or not card.track_ids:
        raise UserError(
            f"Expected a run on a track of the leaderboard, got one on {settings.track} in "
            f"{folder}. Environments of one's own cannot take part: the verifier has to evaluate "
            "the samples again, and nobody else could compare. `sada-gym envs` lists the tracks."
        )
    if settings.agent in agents.names(card.name):
        for track in card.track_ids:
            there = find_target(track, settings.agent).settings
            if there.application_settings == settings.application_settings:
                return track
    raise UserError(
        f"Expected a run on a track of the leaderboard with a shipped agent, got one on "
        f"{settings.track} against {settings.agent} in {folder}, with other settings. Attack one "
        f"of {', '.join(card.track_ids)}."
    )


def _refuse_budget(what: str, budget: int, identity: Identity, option: str) -> None:
    if budget <= identity.budget:
        return
    allowed = {
        rule: today(
            identity.track,
            identity.agent,
            rule,
            identity.adversary,
            identity.preset,
            identity.options,
            resolved=identity.resolved,
        ).budget
        for rule in RULES
    }
    listed = " and ".join(f"{allowed[rule]:,} by the rule {rule}" for rule in RULES)
    raise UserError(
        f"Expected {what} to have a budget of at most {identity.budget:,} queries, got {budget:,}. "
        f"{identity.adversary} may spend {listed} on {identity.track}: choose another --rule, or "
        f"attack again with fewer queries ({option})."
    )


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
) -> _Part:
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
    return _Part(f"the samples of seed {seed}", identity, (claimed,), {seed: run.samples})


def _make_result(identity: Identity, seeds: Sequence[SeedResult]) -> Result:
    if len(seeds) > MAX_SEEDS:
        raise UserError(
            f"Expected at most {MAX_SEEDS} seeds of {identity.stem}, got {len(seeds)}. Submit the "
            "first ones."
        )
    return Result.make(identity, seeds)


def _refuse_other_adversary(part: _Part, first: Identity) -> None:
    for name in ("adversary", "preset", "options"):
        expected, got = getattr(first, name), getattr(part.identity, name)
        if expected != got:
            raise UserError(
                f"Expected all results of an entry to be of one adversary with one set of options, "
                f"got the {name} {got!r} in {part.source} beside {expected!r}. Submit them as two "
                "entries."
            )


def _command(settings: RunSettings) -> str:
    """Give the command that made a run; the folder is left out."""
    words = ["sada-gym", "attack", settings.track, "--adversary", settings.adversary]
    if settings.preset is not None:
        words += ["--preset", settings.preset]
    for name, value in settings.options.items():
        words += ["--set", f"{name}={json.dumps(value)}"]
    words += ["--agent", settings.agent] if settings.agent else []
    words += ["--budget", str(settings.budget), "--seed", str(settings.seed)]
    command = shlex.join(words)
    return command if len(command) <= 1_000 else ""


def _put(results: _Results, credits: Credits, command: str, out: Path, replace: bool) -> Entry:
    """Write an entry beside its place, check it, and put it there together with what is there."""
    about = _make_about(results.first, credits, command)
    folder = out / about.name
    kept = _read_kept(folder, results, replace)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / about.name
        with file_errors("make the folder", made):
            made.mkdir()
        write_about(made, about)
        results.write(made)
        try:
            check_entry(made)
        except UserError as error:
            # of the place that the user knows
            raise UserError(str(error).replace(str(made), str(folder))) from error
        files = {path.name: path.read_bytes() for path in sorted(made.iterdir())}

    def fill(beside: Path) -> None:
        for name, content in (kept | files).items():
            write_file(beside / name, content)

    with file_errors("make the folder", out):
        out.mkdir(parents=True, exist_ok=True)
    write_folder(folder, fill)
    return read_entry(folder)


def _make_about(identity: Identity, credits: Credits, command: str) -> About:
    authors = credits.authors
    try:
        return About(
            format=FORMAT,
            name=credits.name,
            title=credits.title or credits.name,
            authors=tuple(_several(authors, "authors")),
            licence=credits.licence,
            paper=credits.paper,
            repository=credits.repository,
            command=command,
            adversary=identity.adversary,
            preset=identity.preset,
            options=json.dumps(identity.options),
        )
    except ValidationError as error:
        raise UserError(
            f"Expected what an entry says of itself, but {first_error(error)}."
        ) from error


def _read_kept(folder: Path, results: _Results, replace: bool) -> dict[str, bytes]:
    """Read the files of the results that an entry of that name has and that stay.

    Raises:
        UserError: If it is of another adversary, or has one of the results already.
    """
    if not folder.exists() and not folder.is_symlink():
        return {}
    check_entry(folder, submission=False)
    entry = read_entry(folder)
    kept: dict[str, bytes] = {}
    for stem, one in entry.results.items():
        if stem in results.parts:
            if not replace:
                raise UserError(
                    f"Expected a new result, got {stem}, which {folder} has already. Replace it by "
                    "--replace, or give the entry another --name."
                )
            continue
        there = _Part(str(folder), one.claimed.identity, (), {})
        _refuse_other_adversary(there, results.first)
        for ending in (CLAIMS, SAMPLES, VERIFIED):
            path = folder / f"{stem}{ending}"
            if path.exists():
                with file_errors("read", path):
                    kept[path.name] = path.read_bytes()
    return kept
