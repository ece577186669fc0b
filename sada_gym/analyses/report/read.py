"""Reads all that a report tells of one run out of its folder, and draws what is missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from sada_gym.analyses.report.thumbnails import (
    PicturedWorld,
    draw,
    read_thumbnails,
    spread,
    usual_count,
    write_thumbnails,
)
from sada_gym.analyses.report.views import RunView, highlights, mu_alone
from sada_gym.application import Application
from sada_gym.errors import FileError, StoreError, UserError, WorkerError, plain
from sada_gym.evaluations import Evaluations
from sada_gym.measures.diagnosis.record import DIAGNOSIS_FILE, Diagnosis, read_diagnosis
from sada_gym.measures.failures import FAILURES_FILE, read_failures
from sada_gym.run import Run
from sada_gym.run.command import attack_command, from_here
from sada_gym.run.folder import RESULT_FILE
from sada_gym.run.worlds import WorldColumns, read_columns


def columns_of(run: Run, application: Application) -> WorldColumns:
    """Describe the worlds of a run whose application is open."""
    command = ""
    if run.given.by == "toml":
        file = plain(from_here(run.given.path))
        command = attack_command(run.settings, file, samples=True)
    elif run.given.by == "id":
        keywords = run.env_kwargs()
        agent = str(keywords.pop("agent", run.target.agent))
        command = attack_command(
            run.settings, run.target.track, env_kwargs=keywords, agent=agent, samples=True
        )
    return WorldColumns.of(application, command)


def read_view(run: Run) -> RunView:
    """Read what there is to show of a run; notes say what is missing or of another version."""
    notes: list[str] = []
    dimension = run.samples.mu.shape[1]
    columns, result, failures = read_columns(run.folder), None, None
    if columns is not None and len(columns.parameters) != dimension:
        columns = None
    try:
        result = run.result
    except FileError:
        notes.append(
            f"{RESULT_FILE} is missing, damaged or of another version: the attack fooling rate is "
            "that of the samples, and other figures are left out."
        )
    diagnosis: Diagnosis | None = None
    if (run.folder / DIAGNOSIS_FILE).is_file():
        try:
            diagnosis = read_diagnosis(run.folder)
        except FileError:
            notes.append(f"{DIAGNOSIS_FILE} is damaged or of another version, and left out.")
    try:
        failures = read_failures(run.folder)
    except FileError:
        notes.append(f"{FAILURES_FILE} is damaged or of another version, and left out.")
    try:
        queries = run.queries
    except StoreError:
        queries = None
    if queries is None:
        queries = Evaluations.empty(dimension)
        notes.append("run.sqlite is missing, in use or incomplete: there are no training queries.")
    return RunView(
        run=run,
        result=result,
        diagnosis=diagnosis,
        failures=failures,
        queries=queries,
        columns=columns or mu_alone(dimension),
        pictures=read_thumbnails(run.folder),
        notes=tuple(notes),
    )


def complete(
    view: RunView,
    application: Application | str | None = None,
    *,
    wanted: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> RunView:
    """Draw the pictures that a run lacks, and name its parameters, if worlds.json does not.

    Args:
        view: The run; it may be of an older version, or of an application made in Python.
        application: What was attacked. None opens what the run names, if that is possible, where
            worlds.json or pictures are missing.
        wanted: How many pictures of worlds there should be beside those of the first screen; None
            takes as many as an attack draws.
        on_progress: Called after each picture that is drawn, with their numbers so far and in all.

    Raises:
        UserError: If the application is another one.
    """
    is_named = view.columns != mu_alone(len(view.columns.parameters))
    if is_named and application is None and not missing_pictures(view, wanted):
        return view
    try:
        with view.run.open(application) as opened:
            if not is_named:
                view = replace(view, columns=columns_of(view.run, opened.application))
            drawn = draw(opened.application, missing_pictures(view, wanted), on_progress)
    except (UserError, WorkerError) as error:  # a simulator's server may be missing
        if application is not None:
            raise
        lost = "" if is_named else " Parameters have no names and units."
        return replace(view, notes=(*view.notes, f"No further picture was drawn.{lost} {error}"))
    return replace(view, pictures=with_pictures(view, drawn))


def with_pictures(view: RunView, drawn: Mapping[str, bytes]) -> dict[str, bytes]:
    """Write further pictures into the run's folder, those of the first screen first; return all."""
    everything = {**view.pictures, **drawn}
    first = [world.key for worlds in highlights(view) for world in worlds]
    ordered = {key: everything[key] for key in (*first, *everything) if key in everything}
    if list(ordered) == list(read_thumbnails(view.run.folder)):
        return ordered
    try:
        return write_thumbnails(view.run.folder, ordered)
    except FileError:  # a folder that may only be read: the next report draws them again
        return ordered


def missing_pictures(view: RunView, wanted: int | None = None) -> list[PicturedWorld]:
    """List the worlds whose pictures are missing: of the first screen, and `wanted` others."""
    wanted = usual_count(len(view.samples) + len(view.queries)) if wanted is None else wanted
    worlds = []
    for shown in highlights(view):
        lacking = {world.is_film for world in shown if world.key not in view.pictures}
        worlds += shown if lacking == {True, False} else []
    worlds += spread(view.samples, view.target.fooling_threshold, wanted)
    unique = {world.key: world for world in worlds}
    return [world for key, world in unique.items() if key not in view.pictures]
