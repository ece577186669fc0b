"""A table of the board: typed cells, which a page, a CSV and a JSON file show alike."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from sada_gym.results.figures import Figure

Kind = Literal["ranked", "unranked", "control", "paper", "reference"]
"""What a row is. All but entries are grey: controls, the paper's numbers and reference sets."""

SHADES = 10
"""The number of shades of a cell that stands for a rate, beside 0 for none."""


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes:
        key: Its name in the CSV and JSON files.
        title: Its title on the page.
        hint: A sentence that explains it.
        numeric: Whether its cells are numbers.
        choice: Whether the page offers to show the rows of one value alone.
    """

    key: str
    title: str
    hint: str = ""
    numeric: bool = True
    choice: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell.

    Attributes:
        text: What the page shows.
        value: What files hold and what rows are sorted by; None for nothing.
        note: A smaller text behind the first, such as an interval.
        interval: The ends of a 95 % interval.
        href: The page that the cell leads to.
        shade: How dark its background is, from 0 to `SHADES`.
        marks: Short words that stand out, such as the names of flags.
    """

    text: str = ""
    value: float | str | None = None
    note: str = ""
    interval: tuple[float, float] | None = None
    href: str = ""
    shade: int = 0
    marks: tuple[str, ...] = ()


BLANK = Cell()


@dataclass(frozen=True)
class Line:
    """A row of a sheet.

    Attributes:
        kind: What it is.
        cells: Its cells by the columns' keys; columns that are missing stay blank.
    """

    kind: Kind
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Sheet:
    """A table of the board.

    Attributes:
        name: The name of its files, without ending.
        title: What it shows.
        columns: The columns; the first one names the row on the page.
        lines: The rows.
        note: What a reader must know.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    note: str = ""
    kinds: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        """Note which kinds of rows there are."""
        object.__setattr__(self, "kinds", frozenset(line.kind for line in self.lines))

    def csv(self) -> bytes:
        """Give the table as CSV."""
        buffer = io.StringIO()
        rows = self._records()
        writer = csv.DictWriter(buffer, list(rows[0]) if rows else self._fields())
        writer.writeheader()
        writer.writerows({key: _no_formula(value) for key, value in row.items()} for row in rows)
        return buffer.getvalue().encode()

    def json(self) -> bytes:
        """Give the table as JSON: a list with an object for each row."""
        text = json.dumps(self._records(), indent=1, ensure_ascii=False, allow_nan=False)
        return f"{text}\n".encode()

    def _fields(self) -> list[str]:
        with_ends = {
            column.key
            for column in self.columns
            for line in self.lines
            if line.cells.get(column.key, BLANK).interval
        }
        fields = ["kind"]
        for column in self.columns:
            ends = (f"{column.key}_low", f"{column.key}_high") if column.key in with_ends else ()
            fields += [column.key, *ends]
        return fields

    def _records(self) -> list[dict[str, float | str | None]]:
        fields = self._fields()
        records = []
        for line in self.lines:
            record: dict[str, float | str | None] = dict.fromkeys(fields)
            record["kind"] = line.kind
            for column in self.columns:
                cell = line.cells.get(column.key, BLANK)
                record[column.key] = cell.value
                if cell.interval:
                    record[f"{column.key}_low"], record[f"{column.key}_high"] = cell.interval
            records.append(record)
        return records


def text_cell(text: str, *, href: str = "", marks: Iterable[str] = ()) -> Cell:
    """Make a cell of a text."""
    return Cell(text=text, value=text, href=href, marks=tuple(marks))


def number_cell(value: float | None, places: int = 0, *, note: str = "") -> Cell:
    """Make a cell of a number; blank without one."""
    if value is None:
        return BLANK
    return Cell(text=f"{value:,.{places}f}", value=value, note=note)


def rate_cell(rate: float | Figure | None, *, note: str = "", shaded: bool = False) -> Cell:
    """Make a cell of a rate in per cent, with its interval if it has one; blank without a rate."""
    if rate is None:
        return BLANK
    interval = None
    if isinstance(rate, Figure):
        interval, rate = rate.interval_95, rate.value
    if interval is not None:
        low, high = (f"{100 * end:.1f}" for end in interval)
        note = f"{low} – {high}"  # noqa: RUF001
    shade = 1 + min(int(rate * SHADES), SHADES - 1) if shaded else 0
    return Cell(text=f"{100 * rate:.1f}", value=rate, note=note, interval=interval, shade=shade)


def rank_cell(figure: Figure | None) -> Cell:
    """Make a cell of a rank; blank for what has none."""
    if figure is None or figure.rank is None:
        return BLANK
    return Cell(text=figure.rank, value=figure.rank)


def _no_formula(value: float | str | None) -> float | str | None:
    """Keep a spreadsheet from running a text as a formula."""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t")):
        return f"'{value}"
    return value
