"""The density of logged worlds: a table of them, smoothed."""

from __future__ import annotations

import csv
import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.files import MAX_JSON_BYTES, read_file, shown
from sada_gym.parameters import Parameter, ParameterSpace

_FEWEST, _MOST = 20, 2_000
_NARROWEST = 1e-3  # of a range, for a parameter that never changed
_ALL_AROUND = 0.15  # of a turn, the standard deviation of angles that lie all around
_CHUNK = 2_000


class TableDensity:
    """The density around logged worlds, over physical values: a kernel on each row.

    Numbers have Gaussian kernels over shares of their range, as wide as Scott's rule says (1992).
    The rows are shrunk towards their mean first, so that draws vary as the rows do (Silverman and
    Young 1987). Kernels are cut off at the ends of the range; those of angles go around. A choice
    has its frequency, smoothed as if each had been seen once more (Laplace). Of more than 2,000
    rows that many are taken, evenly.

    Attributes:
        space: The parameters.
        rows: The physical values that lie in the ranges, (n, d).
        held: The share of all rows that do; the others are left out.
    """

    def __init__(self, space: ParameterSpace, rows: Any) -> None:
        """Fit the density to physical values, (n, d), or to the path of a CSV file of them.

        Raises:
            UserError: If there are too few rows, or one holds no number.
        """
        is_file = isinstance(rows, str | Path)
        values = _read(space, Path(rows)) if is_file else _array(space, rows)
        for parameter, column in zip(space.parameters, values.T, strict=True):
            if parameter.directions:
                beyond = (column < parameter.low) | (column > parameter.high)
                column[beyond] = parameter.low + (column[beyond] - parameter.low) % 360.0
        shares = _shares(space, values)
        inside = ((shares >= 0.0) & (shares <= 1.0)).all(axis=1)
        if inside.sum() < _FEWEST:
            raise UserError(
                f"Expected a table with at least {_FEWEST} worlds in the ranges, got "
                f"{int(inside.sum())} of {len(values)}. Log more of them, or widen the ranges."
            )
        self.held = float(inside.mean())
        chosen = np.flatnonzero(inside)
        if len(chosen) > _MOST:
            chosen = chosen[np.linspace(0, len(chosen) - 1, _MOST).astype(int)]
        self.rows, self.space = values[chosen], space
        table: dict[str, Any] = {"rows": len(values), "in_ranges": int(inside.sum())}
        if is_file:
            digest = hashlib.sha256(read_file(Path(rows), MAX_JSON_BYTES)).hexdigest()
            table.update(path=str(rows), sha256=digest)
        self.data = {"table": table}
        named = np.array([len(parameter.choices) for parameter in space.parameters])
        self._numbers, self._named = np.flatnonzero(named == 0), np.flatnonzero(named)
        self._counts = named[self._named]
        n, at = len(chosen), shares[chosen][:, self._numbers]
        self._around = np.array([bool(space.parameters[i].directions) for i in self._numbers], bool)
        middle = np.angle(np.exp(2j * np.pi * at).sum(axis=0)) / (2.0 * np.pi)
        mean = np.where(self._around, middle, at.mean(axis=0))
        step = np.where(self._around, (at - mean + 0.5) % 1.0 - 0.5, at - mean)
        spread = step.std(axis=0)
        width = np.maximum(spread * n ** (-1.0 / (len(self._numbers) + 4.0)), _NARROWEST)
        shrunk = spread / np.hypot(spread, width)
        shrunk[self._around & (spread > _ALL_AROUND)] = 1.0  # such angles have no mean
        self._at = np.where(self._around, (mean + shrunk * step) % 1.0, mean + shrunk * step)
        self._width = np.maximum(shrunk * width, _NARROWEST)
        self._cells = self._cell(shares[chosen])
        self._mixed = self._counts / (n + self._counts)
        self._first = np.where(self._around, 0.0, ndtr(-self._at / self._width))
        last = np.where(self._around, 1.0, ndtr((1.0 - self._at) / self._width))
        self._mass = last - self._first
        scale = self._width * np.sqrt(2.0 * np.pi)
        self._weight = -np.log(self._mass * scale).sum(axis=1) - np.log(n)

    def rvs(self, size: int, random_state: np.random.Generator) -> Floats:
        """Draw physical values, (size, d)."""
        rng = random_state
        rows = rng.integers(len(self.rows), size=size)
        shares = np.empty((size, len(self.space)))
        place = self._first[rows] + rng.random((size, len(self._numbers))) * self._mass[rows]
        drawn = self._at[rows] + self._width * ndtri(np.maximum(place, 1e-16))
        shares[:, self._numbers] = np.where(self._around, drawn % 1.0, drawn)
        even = rng.integers(self._counts, size=(size, len(self._counts)))
        cells = np.where(rng.random(even.shape) < self._mixed, even, self._cells[rows])
        shares[:, self._named] = (cells + rng.random(even.shape)) / self._counts
        columns = zip(self.space.parameters, np.clip(shares, 0.0, 1.0).T, strict=True)
        return np.stack([parameter.values(column) for parameter, column in columns], axis=1)

    def logpdf(self, x: Floats) -> Floats:
        """Return the logarithm of the density at physical values, (n, d): (n,), maybe -inf."""
        shares = _shares(self.space, x)
        inside = ((shares >= 0.0) & (shares <= 1.0)).all(axis=1)
        logs = np.full(len(x), -np.inf)
        for rows in np.array_split(np.flatnonzero(inside), 1 + len(x) // _CHUNK):
            logs[rows] = self._log_at(shares[rows])
        for parameter, column in zip(self.space.parameters, x.T, strict=True):
            logs -= np.log(_stretch(parameter, column))
        return logs

    def _log_at(self, shares: Floats) -> Floats:
        scaled = shares[:, self._numbers] / self._width, self._at / self._width
        here, there = (each[:, ~self._around] for each in scaled)
        far = (here**2).sum(axis=1)[:, None] + (there**2).sum(axis=1) - 2.0 * here @ there.T
        logs = self._weight - 0.5 * np.maximum(far, 0.0)
        for k in np.flatnonzero(self._around):
            turn = 1.0 / self._width[k]
            step = np.abs(scaled[0][:, k, None] - scaled[1][:, k])
            near = np.minimum(step, turn - step)
            logs += np.logaddexp(-0.5 * near**2, -0.5 * (turn - near) ** 2)
        for cell, row, count, mixed in zip(
            self._cell(shares).T, self._cells.T, self._counts, self._mixed, strict=True
        ):
            same = cell[:, None] == row
            logs += np.where(same, np.log((1.0 - mixed) * count + mixed), np.log(mixed))
        return np.asarray(logsumexp(logs, axis=1))

    def _cell(self, shares: Floats) -> Any:
        cells = (shares[:, self._named] * self._counts).astype(int)
        return np.minimum(cells, self._counts - 1)


def _shares(space: ParameterSpace, values: Floats) -> Floats:
    columns = zip(space.parameters, values.T, strict=True)
    return np.stack([parameter.shares(column) for parameter, column in columns], axis=1)


def _stretch(parameter: Parameter, values: Floats) -> Floats | float:
    """Return how much of a physical unit a share of the range is, at values, (n,)."""
    low, high = float(parameter.low), float(parameter.high)
    return np.abs(values * np.log(high / low)) if parameter.log else high - low


def _array(space: ParameterSpace, rows: Any) -> Floats:
    try:
        values = np.array(rows, np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"Expected a table of numbers as density, got {error}.") from error
    if values.ndim != 2 or values.shape[1] != len(space):
        raise UserError(
            f"Expected a table of shape (n, {len(space)}) as density, in the order "
            f"{', '.join(space.names)}, got shape {values.shape}."
        )
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise UserError(
            f"Expected finite numbers in the table of worlds, got {values[row, column]} as "
            f"{space.names[column]} in row {row + 1}. Leave such rows out."
        )
    return values


def _read(space: ParameterSpace, path: Path) -> Floats:
    text = read_file(path, MAX_JSON_BYTES).decode("utf-8-sig", "replace")
    separator = max(",;\t", key=text.partition("\n")[0].count)
    table = csv.DictReader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    named = table.fieldnames or ()
    missing = [name for name in space.names if name not in named]
    if missing:
        raise UserError(
            f"Expected the columns {', '.join(space.names)} in {path}, got none named {missing[0]} "
            f"among {shown(', '.join(named)) or 'nothing'}."
        )
    return _array(
        space,
        [
            [_number(parameter, row[parameter.name], path, i) for parameter in space.parameters]
            for i, row in enumerate(table, 1)
        ]
        or np.empty((0, len(space))),
    )


def _number(parameter: Parameter, text: str | None, path: Path, row: int) -> float:
    if text in parameter.choices:
        width = (parameter.high - parameter.low) / len(parameter.choices)
        return parameter.low + (parameter.choices.index(str(text)) + 0.5) * width
    try:
        return float(text or "")
    except ValueError:
        expected = ", ".join(parameter.choices) or "a number"
        raise UserError(
            f"Expected {expected} as {parameter.name} in row {row} of {path}, got {text or ''!r}."
        ) from None
