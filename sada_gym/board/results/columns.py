"""The columns of tables whose lines are rows: each figure's title, format and explanation."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sada_gym.board.results.rows import MEANS, Row
from sada_gym.board.results.sheet import (
    BLANK,
    Cell,
    Column,
    number_cell,
    rate_cell,
    text_cell,
    text_column,
)

RowCell = Callable[[Row, int], Cell]
"""Makes a row's cell, with this number of decimal places if it is in per cent."""


def _runs(row: Row, _: int) -> Cell:
    failed = f", {row.failed} failed" if row.failed else ""
    note = "" if row.complete else "incomplete"
    return Cell(text=f"{row.runs}{failed}", value=row.runs, note=note)


def _rate(key: str, title: str, hint: str) -> tuple[Column, RowCell]:
    return Column(key, title, hint), lambda row, places: rate_cell(getattr(row, key), places)


def _mean(name: str, decimals: int | None) -> RowCell:
    if decimals is None:
        return lambda row, places: rate_cell(row.means[name], places)
    return lambda row, _: number_cell(row.means[name], decimals)


_COLUMNS: tuple[tuple[Column, RowCell], ...] = (
    (text_column("adversary"), lambda row, _: text_cell(row.label)),
    _rate(
        "f1",
        "F1, %",
        "How often the samples fool and how much they cover, in one figure, with its 95 % "
        "interval: the harmonic mean of AFR / ideal AFR (at most 100 %) and coverage / ideal.",
    ),
    (
        Column(
            "rank",
            "rank",
            "By F1, within this table; by AFR where there is no coverage. Rows that the data "
            "cannot tell apart share it.",
            blank="",
        ),
        lambda row, _: BLANK if row.rank is None else text_cell(row.rank),
    ),
    _rate("afr", "AFR, %", "Attack fooling rate, mean over tracks, with its 95 % interval."),
    _rate("afr_iqm", "IQM, %", "The interquartile mean of the AFR over all runs."),
    _rate(
        "relative_coverage",
        "coverage / ideal, %",
        "The share of the known failures that the samples cover; ideal samples are 100 %.",
    ),
    (
        Column("coverage", "coverage, %", "The same without dividing by ideal samples' coverage."),
        lambda row, places: rate_cell(row.coverage.value if row.coverage else None, places),
    ),
    (
        Column("queries", "queries", "Training queries a run; this is the submitter's word."),
        lambda row, _: number_cell(row.queries),
    ),
    (Column("runs", "runs", "Tracks times seeds."), _runs),
    *(
        (Column(name, measure.title, measure.hint), _mean(name, measure.places))
        for name, measure in MEANS.items()
        if measure.title
    ),
)
COLUMNS = {column.key: (column, cell) for column, cell in _COLUMNS}
"""The columns of rows by key, each with the function that makes its cells."""


def row_columns(*keys: str) -> tuple[Column, ...]:
    """Return the columns with these keys."""
    return tuple(COLUMNS[key][0] for key in keys)


def row_cells(row: Row, keys: Sequence[str], places: int = 1) -> dict[str, Cell]:
    """Return the cells of a row by the keys of their columns.

    Args:
        row: The row.
        keys: The keys of the columns. Keys of other tables are ignored.
        places: The decimal places of rates in per cent.
    """
    return {key: COLUMNS[key][1](row, places) for key in keys if key in COLUMNS}
