"""The worlds of a run as a table, worlds.csv, and worlds.json, which says what its columns are."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from typing_extensions import Self

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Integers
from sada_gym.foundations.files import OneLine, Strict, read_model, write_file, write_model
from sada_gym.foundations.frames import LegendEntry, Mark
from sada_gym.measures.diagnosis.record import Condition, SumCondition
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.parameters import Mu, Parameter, ParameterSpace

WORLDS_FILE = "worlds.csv"
COLUMNS_FILE = "worlds.json"

_FIXED = ("role", "row", "score", "fooled", "invalid", "seed", "weakness", "behaviour")
_CHUNK = 10_000


class ParameterColumn(Strict):
    """A parameter, with the fields of `Parameter`, and its `column` in worlds.csv."""

    column: OneLine
    name: OneLine
    low: float
    high: float
    unit: OneLine = ""
    choices: tuple[str, ...] = ()
    directions: tuple[str, ...] = ()
    log: bool = False
    whole: bool = False

    @property
    def parameter(self) -> Parameter:
        """The parameter."""
        return Parameter(**{name: getattr(self, name) for name in _PARAMETER})


_PARAMETER = tuple(name for name in ParameterColumn.model_fields if name != "column")


class LegendRow(Strict):
    """An entry of the legend of an application's frames, see `LegendEntry`."""

    text: OneLine
    colour: str
    mark: Mark


class WorldColumns(Strict):
    """worlds.json: what worlds.csv and a report say of worlds without the application.

    Attributes:
        parameters: The parameters in the order of mu.
        legend: What the marks in pictures mean.
        command: The command that made the run, without --out; empty where none can.
    """

    parameters: tuple[ParameterColumn, ...]
    legend: tuple[LegendRow, ...] = ()
    command: OneLine = ""

    @classmethod
    def of(cls, application: Application, command: str = "") -> Self:
        """Describe the worlds of an application."""
        parameters, taken = [], {*_FIXED}
        for parameter in application.parameters.parameters:
            name = parameter.name
            suffix = parameter.unit.replace("/", "_")
            if suffix and not name.endswith(f"_{suffix}"):
                name = f"{name} [{parameter.unit}]"
            while name in taken:
                name += " (parameter)"
            taken.add(name)
            fields = {field: getattr(parameter, field) for field in _PARAMETER}
            parameters.append(ParameterColumn(column=name, **fields))
        return cls(parameters=tuple(parameters), legend=_legend(application), command=command)

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return ParameterSpace(*(column.parameter for column in self.parameters))


def _legend(application: Application) -> tuple[LegendRow, ...]:
    try:
        given = [LegendEntry(*entry) for entry in application.legend]
        return tuple(LegendRow(text=e.text, colour=e.colour, mark=e.mark) for e in given)
    except Exception:  # a user's code: the sheet of failures tells what is wrong with it
        return ()


def read_columns(folder: Path) -> WorldColumns | None:
    """Read worlds.json of a run; None where there is none, as in older runs, or it is damaged."""
    path = folder / COLUMNS_FILE
    if not path.is_file():
        return None
    try:
        columns = read_model(path, WorldColumns)
        assert columns.space
    except (FileError, UserError, ValidationError):
        return None
    return columns


def parameters_of(conditions: Sequence[Condition]) -> list[str]:
    """List the parameters that conditions are on, in their order."""
    names = []
    for condition in conditions:
        names.append(condition.parameter)
        if isinstance(condition, SumCondition):
            names.append(condition.other)
    return list(dict.fromkeys(names))


def weakness_of(
    rules: Sequence[Sequence[Condition]], space: ParameterSpace, mu: Mu
) -> npt.NDArray[np.int64]:
    """Return the number, from 1, of the first rule that holds for each mu, (n, d); 0 where none.

    Conditions on parameters that the space lacks never hold.
    """
    found = np.zeros(len(mu), np.int64)
    for number, conditions in enumerate(rules, 1):
        if len(mu) and {*parameters_of(conditions)} <= {*space.names}:
            found[(found == 0) & holds(conditions, space, mu)] = number
    return found


def write_worlds(
    folder: Path,
    columns: WorldColumns,
    samples: Evaluations,
    queries: Evaluations,
    threshold: float,
    rules: Sequence[Sequence[Condition]],
    behaviours: Mapping[int, str],
) -> None:
    """Write worlds.csv and worlds.json into a run's folder.

    Args:
        folder: The run's.
        columns: What there is to say of its worlds.
        samples: The test samples, which come first.
        queries: The training queries.
        threshold: The agent is fooled where Q <= this.
        rules: The conditions of each weakness.
        behaviours: What the agent did, by the sample's row.
    """
    lines = _lines(columns, samples, "sample", threshold, rules, behaviours)
    more = _lines(columns, queries, "query", threshold, rules, {})
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)  # RFC 4180: CRLF, and quotes where they are needed
    writer.writerow([*_FIXED[:6], *(plain(c.column) for c in columns.parameters), *_FIXED[6:]])
    writer.writerows(lines)
    writer.writerows(more)
    write_file(folder / WORLDS_FILE, buffer.getvalue())
    write_model(folder / COLUMNS_FILE, columns)


def _lines(
    columns: WorldColumns,
    worlds: Evaluations,
    role: Literal["sample", "query"],
    threshold: float,
    rules: Sequence[Sequence[Condition]],
    behaviours: Mapping[int, str],
) -> Iterator[list[Any]]:
    space, fooled = columns.space, worlds.fooled(threshold)
    for start in range(0, len(worlds), _CHUNK):
        part = worlds[start : start + _CHUNK]
        values = space.physical(part.mu)
        cells = [
            _cells(parameter, column)
            for parameter, column in zip(space.parameters, values.T, strict=True)
        ]
        weakness = weakness_of(rules, space, part.mu)
        for i, row in enumerate(range(start, start + len(part))):
            yield [
                role,
                row,
                repr(float(part.score[i])),
                int(fooled[row]),
                int(part.invalid[i]),
                int(part.seed[i]),
                *(column[i] for column in cells),
                int(weakness[i]) or "",
                plain(behaviours.get(row, "")),
            ]


def _cells(parameter: Parameter, values: npt.NDArray[np.float64]) -> Sequence[Any]:
    """Write physical values: choices by their names, whole numbers without a point."""
    if parameter.choices:
        names = [plain(name) for name in parameter.choices]
        return [names[i] for i in choice_of(parameter, values)]
    if parameter.whole:
        low, high = math.ceil(parameter.low), math.floor(parameter.high)
        return [min(max(math.floor(value + 0.5), low), high) for value in values.tolist()]
    return [repr(value) for value in values.tolist()]


def choice_of(parameter: Parameter, values: npt.NDArray[np.float64]) -> Integers:
    """Return the number, from 0, of the choice that each physical value, (n,), lies in."""
    count = len(parameter.choices)
    share = (values - parameter.low) / (parameter.high - parameter.low)
    return np.clip(np.floor(share * count), 0, count - 1).astype(np.int64)


def plain(text: str) -> str:
    """Keep a spreadsheet from running a text as a formula; a number stays one."""
    if not text.startswith(("=", "+", "-", "@", "\t", "\r")):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text
