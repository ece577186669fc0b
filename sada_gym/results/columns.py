"""The columns of tables whose lines are rows: each figure's title, format and explanation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sada_gym.results.rows import MEANS, Measure, Row
from sada_gym.results.sheet import BLANK, Cell, Column, number_cell, rate_cell, text_cell


@dataclass(frozen=True)
class RowColumn:
    """A column that shows rows.

    Attributes:
        column: The column.
        cell: Makes a row's cell, with as many decimal places where it is in per cent.
    """

    column: Column
    cell: Callable[[Row, int], Cell]


def _runs(row: Row, _: int) -> Cell:
    failed = f", {row.failed} failed" if row.failed else ""
    note = "" if row.complete else "incomplete"
    return Cell(text=f"{row.runs}{failed}", value=row.runs, note=note)


def _mean(name: str, measure: Measure) -> RowColumn:
    def cell(row: Row, places: int) -> Cell:
        value = getattr(row, name)
        if measure.places is None:
            return rate_cell(value, places)
        return number_cell(value, measure.places)

    return RowColumn(Column(name, measure.title, measure.hint), cell)


_COLUMNS = (
    RowColumn(Column("adversary", "adversary", numeric=False), lambda row, _: text_cell(row.label)),
    RowColumn(
        Column(
            "f1",
            "F1, %",
            "How often the samples fool and how much they cover, in one figure, with its 95 % "
            "interval: the harmonic mean of AFR / ideal AFR (at most 100 %) and coverage / ideal.",
        ),
        lambda row, places: rate_cell(row.f1, places),
    ),
    RowColumn(
        Column(
            "rank",
            "rank",
            "By F1, within this table; by AFR where there is no coverage. Rows that the data "
            "cannot tell apart share it.",
            blank="",
        ),
        lambda row, _: BLANK if row.rank is None else text_cell(row.rank),
    ),
    RowColumn(
        Column("afr", "AFR, %", "Attack fooling rate, mean over tracks, with its 95 % interval."),
        lambda row, places: rate_cell(row.afr, places),
    ),
    RowColumn(
        Column("afr_iqm", "IQM, %", "The interquartile mean of the AFR over all runs."),
        lambda row, places: rate_cell(row.afr_iqm, places),
    ),
    RowColumn(
        Column(
            "relative_coverage",
            "coverage / ideal, %",
            "The share of the known failures that the samples cover; ideal samples are 100 %.",
        ),
        lambda row, places: rate_cell(row.relative_coverage, places),
    ),
    RowColumn(
        Column("coverage", "coverage, %", "The same without dividing by ideal samples' coverage."),
        lambda row, places: rate_cell(row.coverage.value if row.coverage else None, places),
    ),
    RowColumn(
        Column("queries", "queries", "Training queries a run; this is the submitter's word."),
        lambda row, _: number_cell(row.queries),
    ),
    RowColumn(Column("runs", "runs", "Tracks times seeds."), _runs),
    *(_mean(name, measure) for name, measure in MEANS.items() if measure.title),
)
COLUMNS = {column.column.key: column for column in _COLUMNS}
"""All columns by their keys."""


def row_columns(*keys: str) -> tuple[Column, ...]:
    """List columns by their keys."""
    return tuple(COLUMNS[key].column for key in keys)


def row_cells(row: Row, keys: Sequence[str], places: int = 1) -> dict[str, Cell]:
    """Return a row's cells by their columns' keys.

    Args:
        row: The row.
        keys: The columns; those that are not of rows are left out.
        places: The decimal places of what is shown in per cent.
    """
    return {key: COLUMNS[key].cell(row, places) for key in keys if key in COLUMNS}
