"""Writes report.html of a run, or of two side by side."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from sada_gym.analyses.report.page import page
from sada_gym.analyses.report.read import (
    columns_of,
    complete,
    missing_pictures,
    read_view,
    with_pictures,
)
from sada_gym.analyses.report.thumbnails import draw, picture_of, sample
from sada_gym.analyses.report.views import RunView
from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, check_integer
from sada_gym.foundations.files import as_path, shown, write_file
from sada_gym.foundations.frames import Frame
from sada_gym.run import Run
from sada_gym.run.folder import REPORT_FILE
from sada_gym.run.run import as_run

MAX_PICTURES = 2_000
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_SCREEN = "--window-size=1400,900"


def report_attack(
    run: Run,
    application: Application,
    frames: Mapping[int, Frame],
    *,
    html: bool,
    on_progress: Callable[[int, int], None],
) -> None:
    """Write worlds.csv at the end of an attack, and the report if `html` says so.

    Args:
        run: The run, with what further analyses have left in its folder.
        application: What it attacked.
        frames: Those that are drawn already, by the sample's row.
        html: Whether to write the report.
        on_progress: See `report`.
    """
    view = read_view(run)
    drawn = {sample(run.samples, row).key: picture_of(frame) for row, frame in frames.items()}
    view = replace(view, columns=columns_of(run, application), pictures={**view.pictures, **drawn})
    view.write_worlds()
    if html:
        more = draw(application, missing_pictures(view), on_progress)
        view = replace(view, pictures=with_pictures(view, more))
        write_file(run.folder / REPORT_FILE, page(view))


def report(
    run: Run | str | Path,
    other: Run | str | Path | None = None,
    *,
    out: str | Path | None = None,
    application: Application | str | None = None,
    pictures: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Path:
    """Write the report of a run, or of two runs side by side, and return its path.

    It also rewrites worlds.csv. Two runs can be of one agent with two adversaries, or of two agents
    in the same kind of worlds. The same runs give the same bytes.

    Args:
        run: A run, or its folder.
        other: A second run to compare with, or its folder.
        out: The file to write; None takes RUN/report.html, or RUN/report-OTHER.html for two runs. A
            name that ends in .png gives a picture of the first screen, if Chromium is installed.
        application: What was attacked: an `Application`, an environment's id, or a TOML file. None
            opens what the run records, if that is possible and pictures are missing.
        pictures: How many worlds to draw in addition to those on the first screen; None draws as
            many as an attack does. They are kept in thumbnails.zip.
        on_progress: Called after each new picture, with the numbers of pictures so far and in all.

    Raises:
        UserError: If an argument is bad, or the application is not the one that was attacked.
        FileError: If a folder holds no finished run, or the report cannot be written.
    """
    if pictures is not None:
        check_integer("pictures", pictures, 0, MAX_PICTURES)
    runs = [as_run(run), *([] if other is None else [as_run(other)])]
    if other is not None and runs[0].folder.resolve() == runs[1].folder.resolve():
        raise UserError(f"Expected two runs, got {run} twice. Name another, or one alone.")
    views: list[RunView] = []
    for one in runs:
        view = complete(read_view(one), application, wanted=pictures, on_progress=on_progress)
        try:
            view.write_worlds()
        except FileError as error:  # a folder that may only be read
            view = replace(view, notes=(*view.notes, f"worlds.csv is left as it was. {error}"))
        views.append(view)
    name = REPORT_FILE if other is None else f"report-{runs[1].name}.html"
    path = runs[0].folder / name if out is None else as_path(out, "the report")
    content = page(*views)
    write_file(path, first_screen(content) if path.suffix.lower() == ".png" else content)
    return path


def first_screen(content: bytes) -> bytes:
    """Return the top of a page as a PNG, which Chromium draws; a UserError where there is none."""
    program = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if program is None:
        raise UserError(
            f"Expected a browser that draws a PNG, got none of {', '.join(_BROWSERS)}. Install "
            "Chromium, such as by apt-get install chromium, or name a file that ends in .html."
        )
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / "page.html", Path(folder) / "page.png"
        source.write_bytes(content)
        words = [program, "--headless", "--no-sandbox", "--hide-scrollbars", _SCREEN,
                 f"--user-data-dir={folder}", f"--screenshot={made}", source.as_uri()]  # fmt: skip
        done = subprocess.run(words, capture_output=True, check=False, timeout=120)
        if done.returncode or not made.is_file():
            reason = shown(done.stderr.decode(errors="replace")[-200:])
            raise UserError(f"Expected a picture of the page from {program}, got: {reason}")
        return made.read_bytes()
