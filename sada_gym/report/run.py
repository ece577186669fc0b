"""All that a report tells of one run, read from its folder or handed over by an attack."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.application import Application
from sada_gym.diagnosis.record import DIAGNOSIS_FILE, Diagnosis, Example, read_diagnosis
from sada_gym.errors import FileError, StoreError, UserError, WorkerError, plain
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.command import attack_command, from_here
from sada_gym.experiment.finished import check_samples, open_target, read_run, source_of
from sada_gym.experiment.folder import RESULT_FILE, STORE_FILE
from sada_gym.experiment.record import RunReport, RunSettings
from sada_gym.experiment.target import Target
from sada_gym.failures import FAILURES_FILE, Failures, read_failures
from sada_gym.files import read_model
from sada_gym.measures.failure_regions import Condition
from sada_gym.parameters import ParameterSpace
from sada_gym.plots.failure_choice import choose_failures
from sada_gym.report.thumbnails import (
    World,
    draw,
    read_thumbnails,
    sample,
    spread,
    usual_count,
    write_thumbnails,
)
from sada_gym.report.worlds import Column, WorldColumns, read_columns, weakness_of, write_worlds

_EACH = 3  # pictures of a weakness


@dataclass(frozen=True)
class ReportedRun:
    """A finished run.

    Attributes:
        result: Its figures; None where another version wrote result.json.
        diagnosis: None where there is none.
        queries: The training queries; none where run.sqlite does not tell them.
        pictures: Small pictures of worlds, WebP, by `World.key`.
        failures: The list of failures; None where there is none.
        notes: What a reader must know of the report itself.
    """

    folder: Path
    settings: RunSettings
    result: RunReport | None
    diagnosis: Diagnosis | None
    samples: Evaluations
    queries: Evaluations
    columns: WorldColumns
    pictures: Mapping[str, bytes]
    failures: Failures | None = None
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of its folder."""
        return plain(self.folder.absolute().name)

    @property
    def target(self) -> Target:
        """What was attacked."""
        return self.settings.experiment.target

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return self.columns.space

    @cached_property
    def behaviours(self) -> dict[int, str]:
        """What the agent did, by the sample's row, where it is known."""
        listed = () if self.failures is None else self.failures.failures
        return {one.sample: one.behaviour for one in listed if one.behaviour}

    @cached_property
    def told(self) -> dict[int, str]:
        """The same, and on how many fresh seeds the failure came again, where that was tried."""
        told = {}
        for one in () if self.failures is None else self.failures.failures:
            parts = [one.behaviour] if one.behaviour else []
            if one.valid_seeds:
                parts.append(f"fails again on {one.fooled_seeds} of {one.valid_seeds} fresh seeds")
            if parts:
                told[one.sample] = "; ".join(parts)
        return told

    @property
    def rules(self) -> tuple[tuple[Condition, ...], ...]:
        """The conditions of each weakness: of the diagnosis, or of the figures where it is none."""
        if self.diagnosis is not None:
            return tuple(weakness.conditions for weakness in self.diagnosis.weaknesses)
        if self.result is not None and self.result.where.conditions:
            return (self.result.where.conditions,)
        return ()

    def write_worlds(self) -> None:
        """Write worlds.csv and worlds.json into the folder; nothing where no name is known."""
        if self.columns == _mu_alone(len(self.columns.parameters)):
            return
        threshold = self.target.fooling_threshold
        written = (self.columns, self.samples, self.queries, threshold, self.rules)
        write_worlds(self.folder, *written, self.behaviours)


def columns_of(
    application: Application,
    settings: RunSettings,
    folder: Path,
    env_kwargs: Mapping[str, Any] | None,
) -> WorldColumns:
    """Describe the worlds of a run whose application is open.

    `env_kwargs` are the keywords of the environment's id; None where no id names it.
    """
    source, command = source_of(folder), ""
    if source is not None:
        command = attack_command(settings, plain(from_here(source)), samples=True)
    elif env_kwargs is not None:
        given = {name: value for name, value in env_kwargs.items() if name != "agent"}
        target = settings.experiment.target
        agent = env_kwargs.get("agent", target.agent)
        if isinstance(agent, str | Path):
            command = attack_command(
                settings, target.track, env_kwargs=given, agent=str(agent), samples=True
            )
    return WorldColumns.of(application, command)


def read_reported(
    run: str | Path,
    application: Application | str | None = None,
    *,
    wanted: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> ReportedRun:
    """Read a run for a report; it may be of an older version, or of an application made in Python.

    Args:
        run: The run's folder.
        application: What was attacked. None opens what the run names, if that is possible, where
            worlds.json or pictures are missing.
        wanted: How many pictures of worlds there should be beside those of the first screen; None
            takes as many as an attack draws.
        on_progress: Called after each picture that is drawn, with their numbers so far and in all.

    Raises:
        UserError: If the folder holds no finished run, or the application is another one.
    """
    folder = Path(run)
    settings, samples = read_run(folder)
    notes: list[str] = []
    columns, pictures = read_columns(folder), read_thumbnails(folder)
    if columns is not None and len(columns.parameters) != samples.mu.shape[1]:
        columns = None
    result = None
    try:
        result = read_model(folder / RESULT_FILE, RunReport)
    except FileError:
        notes.append(
            f"{RESULT_FILE} is missing, damaged or of another version: the attack fooling rate is "
            "that of the samples, and other figures are left out."
        )
    diagnosis, failures, more = read_findings(folder)
    notes += more
    count = settings.experiment.protocol.budget if result is None else result.search.queries
    queries = _queries(folder, settings, count, samples.mu.shape[1])
    if queries is None:
        queries = Evaluations.empty(samples.mu.shape[1])
        notes.append("run.sqlite is missing, in use or incomplete: there are no training queries.")
    found = ReportedRun(
        folder=folder,
        settings=settings,
        result=result,
        diagnosis=diagnosis,
        failures=failures,
        samples=samples,
        queries=queries,
        columns=columns or _mu_alone(samples.mu.shape[1]),
        pictures=pictures,
        notes=tuple(notes),
    )
    if columns is not None and application is None and not missing_pictures(found, wanted):
        return found
    call = f"sada_gym.report.make.report({str(run)!r}, application=YOURS)"
    try:
        with open_target(settings, folder, application, call=call) as opened:
            check_samples(samples, opened)
            if columns is None:
                has_id = source_of(folder) is None and not isinstance(application, Application)
                given = settings.experiment.target.env_kwargs() if has_id else None
                found = replace(
                    found, columns=columns_of(opened.application, settings, folder, given)
                )
            drawn = draw(opened.application, missing_pictures(found, wanted), on_progress)
    except (UserError, WorkerError) as error:  # a simulator's server may be missing
        if application is not None:
            raise
        lost = "" if columns else " Parameters have no names and units."
        return replace(found, notes=(*notes, f"No further picture was drawn.{lost} {error}"))
    return replace(found, pictures=with_pictures(found, drawn))


def read_findings(folder: Path) -> tuple[Diagnosis | None, Failures | None, list[str]]:
    """Read what further analyses left in a run's folder, and notes on what cannot be read."""
    diagnosis = failures = None
    notes = []
    if (folder / DIAGNOSIS_FILE).is_file():
        try:
            diagnosis = read_diagnosis(folder)
        except FileError:
            notes.append(f"{DIAGNOSIS_FILE} is damaged or of another version, and left out.")
    try:
        failures = read_failures(folder)
    except FileError:
        notes.append(f"{FAILURES_FILE} is damaged or of another version, and left out.")
    return diagnosis, failures, notes


def with_pictures(run: ReportedRun, drawn: Mapping[str, bytes]) -> dict[str, bytes]:
    """Write further pictures into the run's folder, those of the first screen first; return all."""
    everything = {**run.pictures, **drawn}
    first = [world.key for worlds in highlights(run) for world in worlds]
    ordered = {key: everything[key] for key in (*first, *everything) if key in everything}
    if list(ordered) == list(read_thumbnails(run.folder)):
        return ordered
    try:
        return write_thumbnails(run.folder, ordered)
    except FileError:  # a folder that may only be read: the next report draws them again
        return ordered


def highlights(run: ReportedRun) -> list[list[World]]:
    """Choose up to three failures of each weakness; of no weakness, three failures."""
    if run.diagnosis is not None and run.diagnosis.weaknesses:
        return [
            [_example(one, run.samples) for one in weakness.examples[:_EACH]]
            for weakness in run.diagnosis.weaknesses
        ]
    samples, threshold = run.samples, run.target.fooling_threshold
    fooled = samples.fooled(threshold)
    if run.rules:
        fooled &= weakness_of(run.rules, run.space, samples.mu) == 1
    rows = np.flatnonzero(fooled)
    counts = (0, _EACH, 0)
    chosen = choose_failures(run.space, samples[rows], threshold, counts).typical
    return [[sample(samples, int(rows[one.sample])) for one in chosen]]


def _example(example: Example, samples: Evaluations) -> World:
    mu = np.array(example.mu, np.float32)
    rows = np.flatnonzero((samples.seed == example.seed) & (samples.mu == mu).all(axis=1))
    return World(mu, example.seed, example.score, int(rows[0]) if len(rows) else None)


def missing_pictures(run: ReportedRun, wanted: int | None = None) -> list[World]:
    """List the worlds whose pictures are missing: of the first screen, and `wanted` others."""
    wanted = usual_count(len(run.samples) + len(run.queries)) if wanted is None else wanted
    worlds = [world for worlds in highlights(run) for world in worlds]
    worlds += spread(run.samples, run.target.fooling_threshold, wanted)
    unique = {world.key: world for world in worlds}
    return [world for key, world in unique.items() if key not in run.pictures]


def _queries(folder: Path, settings: RunSettings, count: int, dimension: int) -> Evaluations | None:
    seeds = evaluation_seeds(settings.seed, "train", 0, count)
    if not seeds:
        return Evaluations.empty(dimension)
    if not (folder / STORE_FILE).is_file():
        return None
    try:
        with EvaluationStore(folder / STORE_FILE) as store:
            context = store.context(settings.experiment.target.application)
            return store.evaluations(context, seeds)
    except StoreError:
        return None


def _mu_alone(dimension: int) -> WorldColumns:
    names = [f"mu {i}" for i in range(1, dimension + 1)]
    return WorldColumns(
        parameters=tuple(Column(column=name, name=name, low=-1.0, high=1.0) for name in names)
    )
