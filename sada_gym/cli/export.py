"""`sada-gym export`: the failures of a run as a regression suite, or in forms of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import typer

from sada_gym.cli.console import (
    application_option,
    errors_as_sentences,
    json_option,
    option,
    print_json,
    say,
    scores_progress,
    workers_option,
)
from sada_gym.errors import UserError, check_known


def export(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Folders that `sada-gym attack` wrote, of one track and agent."
    ),
    out_file: Path = option(
        ...,
        "For a suite, a .json file or a folder for suite.json; otherwise a file.",
        "--out",
        metavar="FILE",
    ),
    form: str = option(
        "suite",
        "`suite`; `cases`: one record per test case (.json, .csv); `sarif`: failures for code "
        "hosts; `odd`: the ranges and what was tried in them (.csv, .json, .yaml of OpenODD).",
        "--format",
        metavar="NAME",
    ),
    confirm: int = option(
        3, "The number of fresh seeds; a world must fail (or pass) on most of them.", minimum=0
    ),
    workers: int = workers_option(1),
    application: str | None = application_option(),
    as_json: bool = json_option("the suite"),
) -> None:
    """Write confirmed failures by weakness, and similar worlds that passed, as a suite.

    `sada-gym regress` tests another agent with it. After a stop, the same command continues.
    """
    with errors_as_sentences():
        check_known("--format", [form], ["suite", "cases", "sarif", "odd"])
    if form == "odd":
        _export_domain(runs, out_file, as_json)
        return
    with errors_as_sentences():
        from sada_gym.analyses.regression.export import export as write

        with scores_progress() as progress:
            exported = write(
                runs,
                out_file,
                confirm=confirm,
                form=cast(Any, form),
                application=application,
                workers=workers,
                on_scores=progress,
            )
    suite = exported.suite
    if as_json:
        print_json(suite)
        return
    failures = sum(case.objective == "failure" for case in suite.test_cases)
    say(
        f"{failures} known failures and {len(suite.test_cases) - failures} similar worlds that "
        f"pass: {exported.path}",
        lead="[bold]",
    )
    for number, group in enumerate(suite.groups, 1):
        inside = [case for case in suite.test_cases if case.group == number]
        count = sum(case.objective == "failure" for case in inside)
        say(f"  {number}. {group} (failures: {count}, passes: {len(inside) - count})")
    if suite.unconfirmed:
        say(f"{suite.unconfirmed} failures passed on fresh seeds and are left out.")


def _export_domain(runs: list[Path], out: Path, as_json: bool) -> None:
    with errors_as_sentences():
        from sada_gym.analyses.domain import Domain
        from sada_gym.foundations.files import write_file, write_model
        from sada_gym.run.run import load_run

        if len(runs) != 1:
            raise UserError(f"Expected one run for --format odd, got {len(runs)}. Export each.")
        domain = Domain.of(load_run(runs[0]))
        check_known("ending of --out", [out.suffix], [".csv", ".yaml", ".json"])
        if out.suffix == ".json":
            write_model(out, domain)
        else:
            write_file(out, domain.as_csv() if out.suffix == ".csv" else domain.as_openodd())
    if as_json:
        print_json(domain)
        return
    say(
        f"{domain.worlds:,} worlds; they hit {domain.pairs_tried:,} of {domain.pairs:,} cells of "
        f"parameter pairs: {out}"
    )
