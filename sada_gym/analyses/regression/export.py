"""Exports the failures of runs, confirmed and grouped, with passes like them, as a suite."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.agents.agent_files import find_agent_file
from sada_gym.analyses.ordinary import ORDINARY_SEEDS, ORDINARY_WORLDS, ordinary_worlds
from sada_gym.analyses.regression.compare import verdict_of
from sada_gym.analyses.regression.records import as_csv, as_json, as_sarif
from sada_gym.analyses.regression.suite import (
    Case,
    File,
    Item,
    Objective,
    Ranged,
    Suite,
    Verdict,
    criterion,
    suite_path,
    write_suite,
)
from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, check_integer, plain
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.stored import FreshScores, OnScores, stored_scores, try_again
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.arrays import Indices
from sada_gym.foundations.files import as_path, file_errors, parse_toml, shown, write_file
from sada_gym.measures.diagnosis.grouping import by_weakness
from sada_gym.measures.diagnosis.record import Weakness
from sada_gym.measures.groups import match, places, spread
from sada_gym.parameters import Mu
from sada_gym.run import Run
from sada_gym.run.folder import ELSEWHERE_FILE
from sada_gym.run.given import Given
from sada_gym.run.run import as_runs

Form = Literal["suite", "cases", "sarif"]

MOST_IN_GROUP, FEWEST_IN_GROUP = 40, 10
_OBJECTIVES: Mapping[str, Objective] = {"F": "failure", "C": "control", "O": "ordinary"}
MOST_FAILURES = 100
"""A suite tries at most so many failures, as many of each group, unless these are very many."""

_MOST_SPREAD = 2_000
_ROUNDS = 3
"""So many controls are tried for a failure, until one passes on fresh seeds."""


@dataclass(frozen=True)
class Exported:
    """The suite that was written, and the path of its file."""

    path: Path
    suite: Suite


@dataclass(frozen=True)
class _Tried:
    """A world with its fresh seeds, and for how many of them it fooled."""

    row: int
    seeds: tuple[int, ...]
    fooled_seeds: int
    verdict: Verdict | None


def export(
    runs: Run | str | Path | Sequence[Run | str | Path],
    out: str | Path,
    *,
    confirm: int = 3,
    form: Form = "suite",
    application: Application | str | None = None,
    workers: int | Workers = 1,
    on_scores: OnScores = lambda *_: None,
) -> Exported:
    """Write the failures of finished runs as a regression suite, or in another format.

    It groups the failures among samples and training queries by the weaknesses in the runs'
    diagnoses or, without a diagnosis, into clusters. From each group it tries at most 40 failures
    that lie far apart on `confirm` fresh seeds, and keeps those that fail on most of them. Each
    gets a control: the nearest world that passes on most of its fresh seeds. 100 worlds of ordinary
    use are added, whatever the agent does there. The fresh scores are kept in the first run's
    folder, so that a stopped call continues where it was. It returns an :class:`.Exported`.

    Args:
        runs: Runs of one track and agent, or their folders.
        out: The file to write. For a suite it ends in .json, or is the folder for `suite.json`.
        confirm: The number of fresh seeds; with 0 the failures are not tried again.
        form: `suite`; `cases`, one record for each test case, as JSON or (if `out` ends in .csv)
            as CSV; `sarif`, the failures in the format that code hosts show.
        application: What the runs attacked, if they do not record it, see :meth:`.Run.open`.
        workers: See :class:`~sada_gym.Workers`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: If an argument is bad, a run is not finished or cannot be opened as it was, the
            runs attacked different things, or nothing failed.
    """
    read = as_runs(runs)
    check_integer("confirm", confirm, 0, 1_000)
    if form not in _WRITERS:
        raise UserError(f"Expected one of the forms {', '.join(_WRITERS)}, got {form!r}.")
    path = suite_path(out) if form == "suite" else as_path(out, "a file")
    first = read[0]
    _check_one_target(read)
    with first.open(application, workers=workers) as opened:
        known = _known(read, opened)
        chooser = _Chooser(opened, known, first, _weaknesses(read), confirm, on_scores)
        cases, groups, unconfirmed = chooser.choose()
        ordinary = chooser.ordinary(len(groups) + 1) if form == "suite" else ()
        given = first.given if application is None else Given.of(application, {})
        suite = Suite(
            sources=tuple(f"{run.settings} ({shown(run.folder.name)})" for run in read),
            test_item=_item(first, given, path),
            logical_scenario=tuple(map(Ranged.of, opened.parameters.parameters)),
            pass_criterion=criterion(first.target.fooling_threshold),
            groups=groups,
            unconfirmed=unconfirmed,
            unlucky_controls=chooser.unlucky_controls,
            test_cases=cases,
            ordinary_cases=ordinary,
        )
    with file_errors("make the folder", path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    agent, toml = suite.test_item.agent_file, given.path if given.by == "toml" else None
    _WRITERS[form](path, suite, toml if agent is None else path.parent / agent.path)
    return Exported(path, suite)


_WRITERS: Mapping[str, Callable[[Path, Suite, Path | None], None]] = {
    "suite": lambda path, suite, _: write_suite(path, suite),
    "cases": lambda path, suite, _: write_file(
        path, as_csv(suite) if path.suffix == ".csv" else as_json(suite)
    ),
    "sarif": lambda path, suite, file: write_file(path, as_sarif(suite, file)),
}


class _Chooser:
    """Chooses failures and their controls among known evaluations, and confirms them."""

    def __init__(
        self,
        opened: OpenTarget,
        known: Evaluations,
        run: Run,
        weaknesses: Sequence[Weakness],
        confirm: int,
        on_scores: OnScores,
    ) -> None:
        self._opened, self._known, self._seed = opened, known, run.settings.seed
        self._threshold = run.target.fooling_threshold
        self._folder, self._confirm, self._on_scores = run.folder, confirm, on_scores
        self._weaknesses, self._drawn = weaknesses, 0
        self.unlucky_controls = 0
        self._fooled = known.fooled(self._threshold)
        self._points = places(known.mu, opened.parameters)
        if not self._fooled.any():
            raise UserError(
                f"Expected a run with failures, got {len(known):,} worlds in {run.folder}, none of "
                "which fooled the agent. Attack it with a larger budget or another adversary."
            )

    def choose(self) -> tuple[tuple[Case, ...], tuple[str, ...], int]:
        """Return the suite's cases, what its groups share, and how many were not confirmed."""
        failing, space = np.flatnonzero(self._fooled), self._opened.parameters
        found = by_weakness(self._weaknesses, space, self._known.mu[failing])
        most = min(max(MOST_FAILURES // len(found), FEWEST_IN_GROUP), MOST_IN_GROUP)
        chosen = [
            failing[group.rows[spread(self._points[failing[group.rows]])[:most]]] for group in found
        ]
        tried = self._confirmed(np.concatenate(chosen))
        repeated = [[tried[row] for row in rows if tried[row].verdict == "fail"] for rows in chosen]
        groups = [worlds for worlds in repeated if worlds]
        unconfirmed = len(tried) - sum(map(len, groups))
        if not groups:
            raise UserError(
                f"Expected failures that repeat on {self._confirm} fresh seeds, got none: all "
                f"{unconfirmed} that were tried passed. Choose other seeds' number by --confirm, "
                "or attack again."
            )
        controls = self._controls([world.row for worlds in groups for world in worlds])
        cases = []
        for number, worlds in enumerate(groups, 1):
            for i, world in enumerate(worlds, 1):
                cases.append(self._case(world, f"F{number:02}-{i:02}", number))
                if control := controls.get(world.row):
                    cases.append(self._case(control, f"C{number:02}-{i:02}", number))
        named = zip(found, repeated, strict=True)
        return tuple(cases), tuple(group.where for group, worlds in named if worlds), unconfirmed

    def _controls(self, failures: list[int]) -> dict[int, _Tried]:
        free = {*np.flatnonzero(~self._fooled & ~self._known.invalid).tolist()}
        found: dict[int, _Tried] = {}
        for _ in range(_ROUNDS):
            open_rows = [row for row in failures if row not in found]
            matched = match(self._points[open_rows], self._points, free)
            if not matched:
                break
            tried = self._confirmed(np.array([*matched.values()], np.intp))
            self.unlucky_controls += sum(world.verdict == "fail" for world in tried.values())
            for place, row in matched.items():
                if tried[row].verdict == "pass":
                    found[open_rows[place]] = tried[row]
        return found

    def _confirmed(self, rows: Indices) -> dict[int, _Tried]:
        """Evaluate worlds on fresh seeds; with none of them take what is known."""
        count, known = self._confirm, self._known[rows]
        if count:
            drawn = evaluation_seeds(self._seed, "validation", self._drawn, count * len(rows))
            self._drawn += len(drawn)
            seeds = [tuple(drawn[i : i + count]) for i in range(0, len(drawn), count)]
            fresh = try_again(
                self._opened.evaluator,
                known.mu,
                seeds,
                self._threshold,
                self._folder / ELSEWHERE_FILE,
                self._on_scores,
            )
        else:
            seeds = [(seed,) for seed in known.seed.tolist()]
            fooled, invalid = known.fooled(self._threshold), known.invalid
            fresh = FreshScores(fooled[:, None], invalid[:, None])
        counts = fresh.fooled_seeds.tolist()
        verdicts = map(verdict_of, fresh.fooled, fresh.invalid)
        return {
            row: _Tried(row, own, fooled_seeds, verdict)
            for row, own, fooled_seeds, verdict in zip(
                rows.tolist(), seeds, counts, verdicts, strict=True
            )
        }

    def ordinary(self, group: int) -> tuple[Case, ...]:
        """Draw worlds as in ordinary use, evaluate each once, and return the valid ones."""
        application = self._opened.application
        mu = ordinary_worlds(application, ORDINARY_WORLDS, self._seed)
        seeds = evaluation_seeds(self._seed, "validation", ORDINARY_SEEDS, len(mu))
        store = self._folder / ELSEWHERE_FILE
        scored = stored_scores(self._opened.evaluator, mu, seeds, store, self._on_scores)
        fooled = scored.fooled(self._threshold)
        return tuple(
            self._case(
                _Tried(i, (seeds[i],), int(fooled[i]), "fail" if fooled[i] else "pass"),
                f"O{i + 1:03}", group, mu[i],
            )
            for i in np.flatnonzero(~scored.invalid).tolist()
        )  # fmt: skip

    def _case(self, world: _Tried, name: str, group: int, mu: Mu | None = None) -> Case:
        assert world.verdict is not None
        mu = self._known.mu[world.row] if mu is None else mu
        return Case(
            id=name,
            objective=_OBJECTIVES[name[0]],
            group=group,
            concrete_scenario=self._opened.parameters.describe(mu),
            mu=tuple(mu.tolist()),
            seeds=world.seeds,
            expected_result=world.verdict,
            fooled_seeds=world.fooled_seeds,
        )


def _weaknesses(runs: Sequence[Run]) -> list[Weakness]:
    """Return the weaknesses that runs' diagnoses name, each rule once."""
    diagnoses = filter(None, (run.diagnosis for run in runs))
    named = (weakness for diagnosis in diagnoses for weakness in diagnosis.weaknesses)
    return [*{weakness.text: weakness for weakness in named}.values()]


def _known(runs: Sequence[Run], opened: OpenTarget) -> Evaluations:
    """Join the samples and training queries of runs; each world once."""
    records = []
    for run in runs:
        run.check_samples(opened)
        records += [run.samples] if run.queries is None else [run.samples, run.queries]
    joined = Evaluations.joined(records)
    _, first = np.unique(joined.mu, axis=0, return_index=True)
    return joined[np.sort(first)]


def _check_one_target(runs: Sequence[Run]) -> None:
    first = runs[0].target
    for run in runs[1:]:
        if (run.target.track, run.target.application) != (first.track, first.application):
            raise UserError(
                f"Expected runs that attacked one agent in one application, got {first} in "
                f"{runs[0].folder} and {run.target} with other settings or weights in "
                f"{run.folder}. Export them one by one."
            )


def _item(run: Run, given: Given, suite: Path) -> Item:
    folder, toml, agent = Path(), None, run.target.agent if given.by == "id" else None
    if given.by == "toml":
        folder = given.path.parent
        toml = given.toml or Given.of_file(given.path).toml
        agent = parse_toml(toml.encode(), given.path).get("agent")
    return Item(
        opened_by=given.by,
        target=run.target,
        env_kwargs=run.env_kwargs() if given.by == "id" else {},
        toml=toml,
        folder=_relative(folder, suite) if toml else ".",
        agent_file=_file(agent, folder, suite),
        packages=run.settings.packages,
    )


def _file(agent: object, folder: Path, suite: Path) -> File | None:
    """Describe an agent's file; None where the agent is none."""
    if not isinstance(agent, str) or not agent:
        return None
    with suppress(FileError, OSError):
        path = find_agent_file(folder / os.path.expanduser(agent))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return File(path=_relative(path, suite), sha256=digest)
    return None


def _relative(path: Path, suite: Path) -> str:
    try:
        return plain(Path(os.path.relpath(path, suite.parent)).as_posix())
    except ValueError:  # another drive
        return path.absolute().as_posix()
