"""A table of results: typed cells, which give Markdown, CSV and JSON, and the site's HTML."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from sada_gym.board.results.figures import Figure

Kind = Literal["ranked", "unranked", "control", "paper", "reference"]
"""What a row is. All but entries are grey: controls, the paper's numbers and reference sets."""

SHADES = 10
"""The number of shades of a cell that stands for a rate, beside 0 for none."""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        key: Its name in the CSV and JSON files.
        title: Its title.
        hint: A sentence that explains it.
        numeric: Whether its cells are numbers.
        choice: Whether the web page can filter the rows by its values.
        blank: The text of empty cells in Markdown.
    """

    key: str
    title: str
    hint: str = ""
    numeric: bool = True
    choice: bool = False
    blank: str = "-"

    @property
    def heading(self) -> str:
        """The title as web pages show it, with a capital."""
        return self.title if self.title.startswith("μ") else self.title[:1].upper() + self.title[1:]


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: The text that readers see.
        value: The value in CSV and JSON files, by which rows are sorted; None for nothing.
        note: A smaller text after the first.
        interval: The ends of a 95 % interval, from 0 to 1.
        places: The decimal places of the interval, which is shown in per cent.
        href: The page to which the cell links.
        shade: How dark its background is, from 0 to 10.
        marks: Short highlighted words, such as the names of flags.
        bold: Whether Markdown shows the text in bold.
    """

    text: str = ""
    value: float | str | None = None
    note: str = ""
    interval: tuple[float, float] | None = None
    places: int = 1
    href: str = ""
    shade: int = 0
    marks: tuple[str, ...] = ()
    bold: bool = False

    def markdown(self) -> str:
        """Return the cell as Markdown: the text, then the interval or the note in parentheses."""
        text = f"**{self.text}**" if self.bold else self.text
        note = self.ends(" to ") or self.note
        return f"{text} ({note})".strip() if note else text

    def ends(self, between: str) -> str:
        """Return the ends of the interval in per cent; empty without one."""
        ends = (f"{100 * end:.{self.places}f}" for end in self.interval or ())
        return between.join(ends)


BLANK = Cell()


@dataclass(frozen=True)
class Line:
    """A row of a sheet: `cells` by the columns' keys. Missing columns stay blank."""

    kind: Kind
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Sheet:
    """A table of results. `name` is the name of its files, without the ending."""

    name: str
    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]

    def markdown(self) -> Iterator[str]:
        """Return the lines of a Markdown table."""
        yield _markdown_line(column.title for column in self.columns)
        yield _markdown_line("---" for _ in self.columns)
        for line in self.lines:
            yield _markdown_line(
                (line.cells.get(column.key, BLANK).markdown() or column.blank)
                for column in self.columns
            )

    def csv(self) -> bytes:
        """Return the table as CSV."""
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, self._fields())
        writer.writeheader()
        for record in self.records():
            writer.writerow({key: _no_formula(value) for key, value in record.items()})
        return buffer.getvalue().encode()

    def json(self) -> bytes:
        """Return the table as JSON: a list with an object for each row."""
        text = json.dumps(list(self.records()), indent=1, ensure_ascii=False, allow_nan=False)
        return f"{text}\n".encode()

    def _fields(self) -> list[str]:
        fields = ["kind"]
        for column in self.columns:
            fields.append(column.key)
            if any(line.cells.get(column.key, BLANK).interval for line in self.lines):
                fields += [f"{column.key}_low", f"{column.key}_high"]
        return fields

    def records(self) -> Iterator[dict[str, float | str | None]]:
        """Return a dictionary for each line: the values, and the ends of their intervals."""
        for line in self.lines:
            record: dict[str, float | str | None] = dict.fromkeys(self._fields())
            record["kind"] = line.kind
            for column in self.columns:
                cell = line.cells.get(column.key, BLANK)
                record[column.key] = cell.value
                if cell.interval:
                    record[f"{column.key}_low"], record[f"{column.key}_high"] = cell.interval
            yield record


def markdown_table(columns: Iterable[Column], lines: Iterable[Mapping[str, Cell]]) -> Iterator[str]:
    """Return the lines of a Markdown table of these columns and rows."""
    kept = tuple(Line("ranked", cells) for cells in lines)
    return Sheet("", "", tuple(columns), kept).markdown()


def titled_table(titles: Sequence[str], lines: Iterable[Iterable[Cell]]) -> Iterator[str]:
    """Return the lines of a Markdown table from the columns' titles and the cells of each row."""
    columns = tuple(text_column(title) for title in titles)
    return Sheet("", "", columns, tuple(line_of(columns, cells) for cells in lines)).markdown()


def text_column(key: str, title: str = "", *, hint: str = "", choice: bool = False) -> Column:
    """Make a column of texts; its title is its key by default."""
    return Column(key, title or key, hint, numeric=False, choice=choice)


def line_of(columns: Sequence[Column], cells: Iterable[Cell], kind: Kind = "ranked") -> Line:
    """Make a line from one cell for each column."""
    return Line(kind, {column.key: cell for column, cell in zip(columns, cells, strict=True)})


def entry_link(name: str, title: str) -> Cell:
    """Make a cell that leads to an entry's page."""
    return text_cell(title, href=f"entries/{name}.html")


def text_cell(text: str, *, href: str = "", bold: bool = False) -> Cell:
    """Make a cell from a text."""
    return Cell(text=text, value=text, href=href, bold=bold)


def number_cell(value: float | None, places: int = 0) -> Cell:
    """Make a cell from a number; blank for None."""
    return BLANK if value is None else Cell(f"{value:,.{places}f}", value)


def rate_cell(rate: float | Figure | None, places: int = 1) -> Cell:
    """Make a cell from a rate, in per cent, with its interval if any; blank for None."""
    if rate is None:
        return BLANK
    interval = rate.interval_95 if isinstance(rate, Figure) else None
    value = rate.value if isinstance(rate, Figure) else rate
    return Cell(f"{100 * value:.{places}f}", value, interval=interval, places=places)


def shaded(cell: Cell) -> Cell:
    """Return the cell of a rate with the darker a background the higher it is."""
    if not isinstance(cell.value, float):
        return cell
    return replace(cell, shade=1 + min(int(cell.value * SHADES), SHADES - 1))


def _markdown_line(texts: Iterable[str]) -> str:
    return f"| {' | '.join(text.replace('|', '/') for text in texts)} |"


def _no_formula(value: float | str | None) -> float | str | None:
    """Keep a spreadsheet from running a text as a formula."""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t")):
        return f"'{value}"
    return value
