"""Writes report.html of a run, or of two side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, check_integer
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import RunReport, RunSettings
from sada_gym.files import as_path, write_file
from sada_gym.frames import Frame
from sada_gym.report.page import page
from sada_gym.report.run import (
    ReportedRun,
    columns_of,
    missing_pictures,
    read_findings,
    read_reported,
    with_pictures,
)
from sada_gym.report.thumbnails import draw, picture_of, read_thumbnails, sample

REPORT_FILE = "report.html"
MAX_PICTURES = 2_000


def report_attack(
    application: Application,
    settings: RunSettings,
    outcome: tuple[RunReport, Evaluations, Evaluations],
    folder: Path,
    *,
    env_kwargs: Mapping[str, Any] | None,
    frames: Mapping[int, Frame],
    html: bool,
    on_progress: Callable[[int, int], None],
) -> Path | None:
    """Write worlds.csv at the end of an attack, and the report if `html` says so; return its path.

    Args:
        application: What was attacked.
        settings: The run's.
        outcome: Its figures, test samples and training queries.
        folder: The run's, with what further analyses have left there.
        env_kwargs: The keywords of the environment's id; None where no id names it.
        frames: Those that are drawn already, by the sample's row.
        html: Whether to write the report.
        on_progress: See `report`.
    """
    result, samples, queries = outcome
    diagnosis, failures, notes = read_findings(folder)
    columns = columns_of(application, settings, folder, env_kwargs)
    pictures = {sample(samples, row).key: picture_of(frame) for row, frame in frames.items()}
    run = ReportedRun(
        folder=folder,
        settings=settings,
        result=result,
        diagnosis=diagnosis,
        samples=samples,
        queries=queries,
        columns=columns,
        pictures={**read_thumbnails(folder), **pictures},
        failures=failures,
        notes=tuple(notes),
    )
    run.write_worlds()
    if not html:
        return None
    drawn = draw(application, missing_pictures(run), on_progress)
    run = replace(run, pictures=with_pictures(run, drawn))
    write_file(folder / REPORT_FILE, page(run))
    return folder / REPORT_FILE


def report(
    run: str | Path,
    other: str | Path | None = None,
    *,
    out: str | Path | None = None,
    application: Application | str | None = None,
    pictures: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Path:
    """Write the report of a run, or of two runs side by side, and return its path.

    worlds.csv is written anew, too. Two runs may be of one agent under two adversaries, or of two
    agents in the same kind of worlds. The same runs give the same bytes.

    Args:
        run: The folder that `attack` wrote.
        other: The folder of a second run.
        out: The file to write; None takes RUN/report.html, and RUN/report-OTHER.html of two.
        application: What was attacked: an `Application`, an environment's id, or a TOML file. None
            opens what the run names, if it is needed and can be.
        pictures: How many worlds to draw beside those of the first screen; None draws as many as
            an attack does. They are kept in thumbnails.zip.
        on_progress: Called after each picture that is drawn, with their numbers so far and in all.

    Raises:
        UserError: If an argument is bad, or the application is another one.
        FileError: If a folder holds no finished run, or the report cannot be written.
    """
    if pictures is not None:
        check_integer("pictures", pictures, 0, MAX_PICTURES)
    folders = [as_path(run, "a run's folder")]
    if other is not None:
        folders.append(as_path(other, "a run's folder"))
        if folders[0].resolve() == folders[1].resolve():
            raise UserError(f"Expected two runs, got {run} twice. Name another, or one alone.")
    runs: list[ReportedRun] = []
    for folder in folders:
        found = read_reported(folder, application, wanted=pictures, on_progress=on_progress)
        try:
            found.write_worlds()
        except FileError as error:  # a folder that may only be read
            found = replace(found, notes=(*found.notes, f"worlds.csv is left as it was. {error}"))
        runs.append(found)
    name = REPORT_FILE if other is None else f"report-{runs[1].name}.html"
    path = folders[0] / name if out is None else as_path(out, "the report")
    write_file(path, page(*runs))
    return path
