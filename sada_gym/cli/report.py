"""`sada-gym report`: a page that shows how an agent fails."""

from __future__ import annotations

from pathlib import Path

import typer

from sada_gym.cli.console import (
    application_option,
    err,
    errors_as_sentences,
    json_option,
    option,
    print_json,
    run_argument,
    say,
)


def report(
    run: Path = run_argument(),
    other: Path | None = typer.Argument(
        None, metavar="[OTHER]", help="A second run, to compare both side by side."
    ),
    out_file: Path | None = option(
        None,
        "The page to write, or a .png of its first screen, drawn by Chromium.",
        "--out",
        metavar="FILE",
        shown="RUN/report.html; of two, RUN/report-OTHER.html",
    ),
    pictures: int | None = option(
        None, "How many worlds to draw.", minimum=0, shown="as many as an attack"
    ),
    application: str | None = application_option(),
    as_json: bool = json_option(),
) -> None:
    """Write report.html of a run again, or a page that compares two runs.

    The page is one file that loads nothing from the network. worlds.csv is written again, too.
    """
    with errors_as_sentences():
        from sada_gym.analyses.report.make import report as make

        with err.status("Reading the runs") as status:

            def progress(done: int, total: int) -> None:
                status.update(f"Drawing worlds: {done} of {total}")

            path = make(
                run,
                other,
                out=out_file,
                application=application,
                pictures=pictures,
                on_progress=progress,
            )
    size = path.stat().st_size
    if as_json:
        print_json({"path": path, "size": size})
    else:
        say(f"{path}: {size / 1e6:.2f} MB")


def make_anew(run: Path, application: str | None) -> None:
    """Make a run's report.html again, if it has one, after something was found."""
    from sada_gym.analyses.report.make import report as make
    from sada_gym.run.folder import REPORT_FILE

    if (run / REPORT_FILE).is_file():
        with err.status("Writing report.html again"):
            make(run, application=application)
