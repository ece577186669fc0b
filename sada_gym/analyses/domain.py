"""The operational domain of a run: the ranges, and where in them worlds were tried and failed."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np

from sada_gym.analyses.regression.suite import Ranged
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats32, Integers
from sada_gym.foundations.files import Strict
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Parameter
from sada_gym.run import Run

CELLS, PAIR_CELLS = 10, 5
"""Into how many cells a range is cut: for itself, and for pairs."""


class Cell(Strict):
    """A part of a parameter's range, such as one of its choices or whole numbers.

    Attributes:
        low: Its lower end in the parameter's unit.
        failures: The rate of failures; None where no world was tried.
    """

    low: float
    high: float
    choice: str = ""
    worlds: int
    failures: Rate | None


class Range(Ranged):
    """A parameter of the domain.

    Attributes:
        density: How likely its values are in ordinary use, as it was given; None where unknown.
    """

    density: dict[str, Any] | None
    cells: tuple[Cell, ...]


class Domain(Strict):
    """What a run tried of its ranges.

    Attributes:
        worlds: The training queries and the samples that were valid.
        pairs: The cells of all pairs of parameters, `PAIR_CELLS` for each range.
        pairs_tried: How many of these hold a world.
    """

    track: str
    agent: str
    worlds: int
    ranges: tuple[Range, ...]
    pairs: int
    pairs_tried: int

    @classmethod
    def of(cls, run: Run) -> Domain:
        """Count the worlds of a run.

        Raises:
            UserError: If the run does not say what its parameters are.
        """
        space, queries = run.parameters, run.queries
        if space is None:
            raise UserError(
                f"Expected a run that says what its parameters are, got {run.folder} without "
                "worlds.json. Make it by `sada-gym report`."
            )
        tried = run.samples if queries is None else Evaluations.joined([queries, run.samples])
        mu, fooled = tried.valid.mu, tried.valid.fooled(run.target.fooling_threshold)
        used = run.result.in_use.density if run.result.in_use else {}
        ranges, places = [], []
        for k, parameter in enumerate(space.parameters):
            ranges.append(_range(parameter, mu[:, k], fooled, used.get(parameter.name)))
            places.append(_cells_of(parameter, mu[:, k], PAIR_CELLS))
        pairs = tried_pairs = 0
        for (one, n), (other, m) in combinations(places, 2):
            pairs += n * m
            tried_pairs += len(np.unique(one * m + other))
        return cls(
            track=run.target.track,
            agent=run.target.agent,
            worlds=len(mu),
            ranges=tuple(ranges),
            pairs=pairs,
            pairs_tried=tried_pairs,
        )

    def as_csv(self) -> bytes:
        """Write a row for each cell of each parameter."""
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(
            ("parameter", "unit", "from", "to", "worlds", "failures", "rate", "low", "high")
        )
        for one in self.ranges:
            for cell in one.cells:
                rate = cell.failures
                told = (rate.fooled, rate.rate, *rate.interval_95) if rate else (0, "", "", "")
                ends = (cell.choice, cell.choice) if cell.choice else (cell.low, cell.high)
                writer.writerow((one.name, one.unit, *ends, cell.worlds, *told))
        return text.getvalue().encode()

    def as_openodd(self) -> bytes:
        """Write the ranges as an operational design domain in ASAM OpenODD's YAML."""
        return "\n".join(self._openodd()).encode() + b"\n"

    def _openodd(self) -> Iterator[str]:
        yield f"# {self.track} of {self.agent}: what {self.worlds} worlds were drawn from"
        yield "TAXONOMY:"
        yield "  world:"
        for one in self.ranges:
            kind = "integer" if one.whole else "float"
            unit = f"  # {one.unit}" if one.unit else ""
            yield f"    {_key(one.name)}: {_list(one.choices) if one.choices else kind}{unit}"
        yield "ODD:"
        yield "  ranges:"
        yield "    INCLUDE_AND:"
        for one in self.ranges:
            beyond = 0.5 if one.whole else 0.0  # the range of whole numbers begins half below
            numbers = f'"[{one.low + beyond:.9g} .. {one.high - beyond:.9g}]"'
            within = _list(one.choices) if one.choices else numbers
            yield f"      world.{_key(one.name)}: {within}"


def _range(
    parameter: Parameter, mu: Floats32, fooled: Bools, density: dict[str, Any] | None
) -> Range:
    cell_of, count = _cells_of(parameter, mu, CELLS)
    edges = parameter.values(np.linspace(0.0, 1.0, count + 1)).round(9)
    cells = []
    for k in range(count):
        inside = cell_of == k
        worlds, failed = int(inside.sum()), int(fooled[inside].sum())
        choice = parameter.choices[k] if parameter.choices else ""
        low, high = edges[k : k + 2].tolist()
        rate = Rate.of(failed, worlds) if worlds else None
        cells.append(Cell(low=low, high=high, choice=choice, worlds=worlds, failures=rate))
    return Range(**dict(Ranged.of(parameter)), density=density, cells=tuple(cells))


def _cells_of(parameter: Parameter, mu: Floats32, cells: int) -> tuple[Integers, int]:
    """Return the cell of each world, (n,), and how many cells there are."""
    count = len(parameter.choices) or min(parameter.count or cells, cells)
    return np.clip(((mu + 1.0) / 2.0 * count).astype(np.int64), 0, count - 1), count


def _key(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _list(choices: tuple[str, ...]) -> str:
    return f"[{', '.join(map(_key, choices))}]"
