"""Builds the board's static site: `python -m leaderboard.site --out DIR`."""

from __future__ import annotations

import importlib.metadata
import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import jinja2
import typer

from leaderboard.board import Board, GroupBoard, make_board
from leaderboard.entry_page import describe, entry_page, made_by
from leaderboard.pictures import Pictures
from sada_gym import __version__
from sada_gym.board.results.entry import read_entries
from sada_gym.board.results.rows import Row
from sada_gym.board.results.sheet import (
    BLANK,
    Column,
    Sheet,
    entry_link,
    line_of,
    number_cell,
    text_cell,
    text_column,
)
from sada_gym.cli.console import errors_as_sentences
from sada_gym.errors import MissingExtra, UserError, install_line
from sada_gym.foundations.files import file_errors, read_file, write_folder

HERE = Path(__file__).parent
STATIC = ("board.css", "board.js")
MARK = "board.json"
"""A file of every site that was built here. A folder with other contents is not replaced."""

OnStep = Callable[[str], None]

_MAX_BYTES = 2**22


def build_site(
    entries: Path, out: Path, *, pictures: bool = True, on_step: OnStep = lambda _: None
) -> Board:
    """Build the site from entries, in place of one that was built before.

    The same entries make the same bytes.

    Args:
        entries: The folder of the entries.
        out: The folder of the site.
        pictures: Whether to draw samples and fooled worlds. Those that `out` already has of the
            same samples are kept.
        on_step: Called with a few words before each step.

    Raises:
        UserError: If an entry cannot be read, or `out` holds something else.
    """
    _check_own_folder(out)
    on_step(f"reading the entries in {entries}")
    read = read_entries(entries)
    on_step(f"ranking {len(read)} entries")
    board = make_board(read)
    files = dict(site_files(board, Pictures(pictures, out), on_step))
    on_step(f"writing {len(files)} files to {out}")

    def fill(folder: Path) -> None:
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)

    with file_errors("make the folder", out.parent):
        out.parent.mkdir(parents=True, exist_ok=True)
    write_folder(out, fill)
    return board


def site_files(
    board: Board, pictures: Pictures, on_step: OnStep = lambda _: None
) -> Iterator[tuple[str, bytes]]:
    """Return the site's files: each one's place and content."""
    render = partial(_render, _environment(), board)
    listed = entries_sheet(board)
    sheets = [board.strongest, listed]
    for group in board.groups:
        on_step(f"the page of {group.card.title}")
        yield from render(f"{group.card.page}.html", "group.html", group=group)
        sheets += _sheets_of(group)
    for number, entry in enumerate(board.entries, start=1):
        name = f"the page of the entry {entry.metadata.name}"
        on_step(f"{name}, {number} of {len(board.entries)}, and its pictures")
        page = entry_page(board, entry, pictures)
        yield from render(page.path, "entry.html", page=page)
        sheets += [section.sheet for section in page.sections]
        sheets += [page.outdated] if page.outdated else []
    yield from render("agents.html", "agents.html", sheet=board.strongest)
    yield from render("index.html", "index.html", sheet=listed)
    for sheet in sheets:
        yield f"data/{sheet.name}.csv", sheet.csv()
        yield f"data/{sheet.name}.json", sheet.json()
    yield from pictures.files.items()
    for name in STATIC:
        yield f"static/{name}", read_file(HERE / "static" / name, _MAX_BYTES)
    yield from table_script()
    yield MARK, f'{{"made_by": "sada_gym {__version__}"}}\n'.encode()


def _sheets_of(group: GroupBoard) -> Iterator[Sheet]:
    for _, rankings in group.comparisons:
        for ranking in rankings:
            sheets = (
                ranking.whole,
                ranking.partial,
                ranking.by_track,
                ranking.coverage_by_track,
            )
            yield from filter(None, sheets)
    yield from filter(None, (group.paper_sheet, group.outdated_sheet))


def leaders(group: GroupBoard) -> Iterator[tuple[str, list[str]]]:
    """Return who has rank 1 in each comparison, in the highest tier that ranks anything."""
    for comparison, rankings in group.comparisons:
        for ranking in rankings:
            first = [row for row in ranking.rows if row.is_first]
            if first:
                first.sort(key=lambda row: -row.deciding.value if row.deciding else 0.0)
                more = [f"and {len(first) - _NAMED} more"] if len(first) > _NAMED else []
                leading = [*(_with_figures(row) for row in first[:_NAMED]), *more]
                yield f"{ranking.tier}, {' · '.join(comparison.names)}", leading
                break


def extremes(strongest: Sheet) -> Iterator[tuple[str, str]]:
    """Yield the agents that the strongest attacks fool most and least, each with its track."""
    attacked = [line.cells for line in strongest.lines if "afr" in line.cells]
    for title, cells in zip(
        ("fooled most", "fooled least"), attacked[:1] + attacked[1:][-1:], strict=False
    ):
        texts = {name: cells[name].text for name in ("agent", "track", "afr")}
        yield title, "{agent} on {track}: AFR {afr} %".format(**texts)


def _with_figures(row: Row) -> str:
    figures = (("F1", row.f1), ("AFR", row.afr), ("coverage", row.relative_coverage))
    texts = (f"{name} {100 * figure.value:.0f} %" for name, figure in figures if figure)
    return f"{row.label}: {', '.join(texts)}"


_NAMED = 3  # leaders on a card

_ENTRIES = (
    *(text_column(key) for key in ("entry", "by", "description", "groups")),
    Column("verified", "verified", "The number of results that we verified."),
    Column("claimed", "claimed", "The number of results that we have not verified."),
    Column("outdated", "outdated", "The number of results that no longer compare with others."),
    text_column("date"),
    text_column("licence"),
)


def entries_sheet(board: Board) -> Sheet:
    """List all entries."""
    lines = []
    for entry in board.entries:
        metadata, name = entry.metadata, entry.metadata.name
        late = sum(result.entry.metadata.name == name for result in board.outdated)
        current = {
            group.card.title: own
            for group in board.groups
            for own in group.entries
            if own.metadata.name == name
        }
        tiers = [result.tier for own in current.values() for result in own.results.values()]
        cells = (
            entry_link(name, metadata.title),
            text_cell(made_by(entry)),
            text_cell(describe(entry)),
            text_cell(", ".join(current)),
            number_cell(tiers.count("verified")),
            number_cell(tiers.count("claimed")),
            number_cell(late or None),
            text_cell(metadata.date),
            text_cell(metadata.licence),
        )
        lines.append(line_of(_ENTRIES, cells))
    return Sheet("entries", "All entries", _ENTRIES, tuple(lines))


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    bibtex = (HERE / "templates" / "cite.bib").read_text("utf-8")
    environment.globals |= {
        "version": __version__,
        "bibtex": bibtex.replace("VERSION", __version__),
        "leaders": leaders,
        "extremes": extremes,
        "blank": BLANK,
    }
    return environment


def _render(
    environment: jinja2.Environment, board: Board, path: str, template: str, **values: object
) -> Iterator[tuple[str, bytes]]:
    root = "../" * path.count("/")
    text = environment.get_template(template).render(board=board, path=path, root=root, **values)
    yield path, text.encode()


def table_script() -> Iterator[tuple[str, bytes]]:
    """Return the script that sorts and filters tables, DataTables, and its licence.

    itables has it as a module, which browsers do not load from a file. Here it is a plain script
    that defines `jQuery` alone.

    Raises:
        MissingExtra: If itables is not installed.
        UserError: If it has another form than expected.
    """
    try:
        distribution = importlib.metadata.distribution("itables")
    except importlib.metadata.PackageNotFoundError:
        raise MissingExtra(
            "Expected the package itables, which the site takes its tables' script from, got none. "
            f"{install_line('leaderboard')}"
        ) from None
    files = {file.name: file for file in distribution.files or () if file.parts[0] != ".."}
    for name in ("dt_bundle.js", "LICENSE"):
        if name not in files:
            raise UserError(f"Expected {name} in itables, got none. Install another version of it.")
    text = files["dt_bundle.js"].read_text(encoding="utf-8")
    export = re.compile(r"\bexport\s*\{([^{}]*)\};?")
    names = export.findall(text)
    jquery = re.search(r"([\w$]+) as jQuery\b", names[0]) if len(names) == 1 else None
    if jquery is None:
        raise UserError(
            "Expected dt_bundle.js of itables to export jQuery once, got another form. Install the "
            "version of itables that constraints.txt names."
        )
    script = export.sub(f"globalThis.jQuery={jquery[1]};", text)
    yield "static/datatables.js", f"(()=>{{{script}\n}})();\n".encode()
    yield "static/datatables.LICENSE.txt", files["LICENSE"].read_text(encoding="utf-8").encode()


def _check_own_folder(out: Path) -> None:
    with file_errors("read", out):
        if out.exists() and (not out.is_dir() or any(out.iterdir())) and not (out / MARK).is_file():
            raise UserError(
                f"Expected {out} to be empty or a site that was built before, got something else. "
                "Name another folder."
            )


def main(
    out: Annotated[Path, typer.Option(help="The folder of the site.")],
    entries: Annotated[Path, typer.Option(help="The folder of the entries.")] = HERE / "entries",
    pictures: Annotated[bool, typer.Option(help="Draw samples and fooled worlds.")] = True,
) -> None:
    """Build the board's static site from the entries.

    Each step is told while it is done. Drawing the pictures of all entries takes some 15 minutes;
    those that the folder already has are kept.
    """
    begun = time.monotonic()

    def tell(step: str) -> None:
        minutes, seconds = divmod(int(time.monotonic() - begun), 60)
        typer.echo(f"{minutes:3}:{seconds:02} {step}", err=True)

    with errors_as_sentences():
        board = build_site(entries, out, pictures=pictures, on_step=tell)
    typer.echo(f"{len(board.entries)} entries are on the board: open {out / 'index.html'}.")


if __name__ == "__main__":
    typer.run(main)
