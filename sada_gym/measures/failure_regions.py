"""Failure regions: the few parameter ranges in which an agent's failures crowd."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sada_gym.errors import plain
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.figures import number, percent
from sada_gym.foundations.files import OneLine, Strict
from sada_gym.parameters import Mu, Parameter, ParameterSpace

MIN_FAILURES = 10
"""The least number of different failures of which anything is said."""

MAX_CONDITIONS = 3
"""A sentence with more of them is no answer."""

ALPHA = 0.01
"""The chance that a condition is named although failures are uniform, whatever the dimension."""

MIN_GAINS, MIN_SHARES = (0.15, 0.25, 0.25), (0.5, 0.6, 0.6)
"""The first, second and third condition has to hold for this much more of the failures than of
uniform worlds, and all of them so far for this share of the failures."""

_MOSTLY = 0.6

_MIN_CELLS = 10
_MAX_CELLS = 50
"""Of more choices in an order neighbours share a cell: all ranges are tried."""
_MAX_UNORDERED = 1_000
_OCTANTS = 8


class Condition(Strict):
    """One or more ranges of a parameter, (low, high) in physical values; any of them will do.

    The text is the condition as people say it, such as `camera pitch is above 35°`.
    """

    parameter: str
    ranges: tuple[tuple[float, float], ...]
    text: OneLine


class FailureRegions(Strict):
    """Where the agent fails.

    Attributes:
        conditions: The conditions that hold for most failures, the strongest first; none where
            failures are too few, or no range stands out.
        share: The share of the failures for which all conditions hold; None without any.
        uniform: The same share of uniform worlds.
    """

    sentence: OneLine
    conditions: tuple[Condition, ...] = ()
    share: float | None = None
    uniform: float | None = None


def failure_regions(space: ParameterSpace, failures: Mu) -> FailureRegions:
    """Find the ranges of one to three parameters in which failures crowd, against uniform worlds.

    One parameter after another is chosen, among the failures for which the conditions so far hold:
    the range whose likelihood ratio against uniform is largest, as in Kulldorff's scan statistic
    (1997). A range counts if n KL(p, v) >= log(tests / ALPHA), where p of n failures and v of
    uniform worlds lie in it: by Chernoff's bound and the sum over all tests, that happens with a
    chance of at most ALPHA where failures are uniform. An adversary that found one kind of failure
    shows that kind only. Failures, (n, d) as `ParameterSpace.validate` takes them, are the mu that
    fooled; repeated rows count once.
    """
    mu = space.validate(failures)
    different = np.unique(mu + np.float32(0.0), axis=0)
    if len(different) < MIN_FAILURES:
        return FailureRegions(sentence=too_few(len(mu), len(different)))
    values, among = space.physical(different), np.ones(len(different), dtype=np.bool_)
    findings: dict[int, _Finding] = {}
    uniform = 1.0
    while len(findings) < MAX_CONDITIONS:
        best = _strongest(space, values, among, findings)
        if best is None:
            break
        index, finding, inside = best
        among, uniform, findings[index] = inside, uniform * finding.uniform, finding
    if not findings:
        return FailureRegions(
            sentence="Nowhere in particular: no range of a parameter holds clearly more of the "
            f"{len(different):,} failures than of uniform worlds."
        )
    conditions = tuple(
        condition(space.parameters[index], finding.grid.edges, finding.cells)
        for index, finding in findings.items()
    )
    share = float(among.mean())
    mostly = "always" if share == 1.0 else "mostly" if share >= _MOSTLY else "more often"
    listed = " and ".join(condition.text for condition in conditions)
    return FailureRegions(
        sentence=f"Fails {mostly} where {listed}: {percent(share)} of the {len(different):,} "
        f"failures, against {percent(uniform)} of uniform worlds.",
        conditions=conditions,
        share=share,
        uniform=uniform,
    )


def too_few(failures: int, different: int, kind: str = "sample") -> str:
    """Say that so many failures, so many of them different, say nothing; `kind` are the worlds."""
    if not failures:
        return f"No {kind} fooled the agent."
    if different < failures:
        worlds = "one world" if different == 1 else f"{different} different worlds"
        return f"The {failures:,} failures are {worlds}, too few to say where the agent fails."
    count = f"Only one {kind}" if failures == 1 else f"Only {failures} {kind}s"
    return f"{count} fooled the agent, too few to say where it fails."


@dataclass(frozen=True)
class _Grid:
    """The cells into which a parameter's range is cut, and the sets of cells that are tried."""

    edges: Floats  # (k + 1,) physical values; cell i lies between edges i and i + 1
    sets: Bools | None  # (m, k); None tries all sets, for choices
    parameter: Parameter | None = None  # where it may be logarithmic

    @property
    def weights(self) -> Floats:
        """(k,) the shares of uniform worlds in the cells."""
        edges = self.edges if self.parameter is None else self.parameter.shares(self.edges)
        widths: Floats = np.diff(edges) / (edges[-1] - edges[0])
        return widths

    @property
    def log_tests(self) -> float:
        """The logarithm of the number of sets."""
        if self.sets is None:
            return (len(self.edges) - 1) * math.log(2.0)
        return math.log(len(self.sets))


@dataclass(frozen=True)
class _Finding:
    grid: _Grid
    cells: Bools  # (k,)
    uniform: float  # the share of uniform worlds in the cells


def _strongest(
    space: ParameterSpace, values: Floats, among: Bools, findings: dict[int, _Finding]
) -> tuple[int, _Finding, Bools] | None:
    open_ = [index for index in range(len(space)) if index not in findings]
    best, best_ratio = None, 0.0
    for index in open_:
        parameter = space.parameters[index]
        if len(parameter.choices) > _MAX_UNORDERED and not is_ordered(parameter):
            continue  # each has too few failures
        grid = _grid(parameter)
        if len(grid.weights) < 2:  # a single choice
            continue
        column = values[:, index] % 360.0 if parameter.directions else values[:, index]
        cell = np.searchsorted(grid.edges[1:-1], column, side="right")
        counts = np.bincount(cell[among], minlength=len(grid.weights)).astype(np.float64)
        sets = _largest_sets(counts) if grid.sets is None else grid.sets
        total = counts.sum()
        inside, uniform = sets @ counts, sets @ grid.weights
        ratio = _likelihood_ratio(inside / total, uniform) * total
        counts_as = (
            (ratio >= grid.log_tests + math.log(len(open_) / ALPHA))
            & (inside / total >= uniform + MIN_GAINS[len(findings)])
            & (inside >= MIN_SHARES[len(findings)] * len(values))
        )
        ratio = np.where(counts_as, ratio, 0.0)
        row = int(np.argmax(ratio))
        if ratio[row] > best_ratio:
            best_ratio = float(ratio[row])
            finding = _Finding(grid, sets[row], float(uniform[row]))
            best = index, finding, among & sets[row][cell]
    return best


def _likelihood_ratio(share: Floats, uniform: Floats) -> Floats:
    """Return the log likelihood ratio of a failure: KL(share, uniform), 0 where share is less."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.where(share > 0.0, share * np.log(share / uniform), 0.0)
        outside = np.where(share < 1.0, (1.0 - share) * np.log((1.0 - share) / (1.0 - uniform)), 0)
    return np.where(share > uniform, inside + outside, 0.0)


def _grid(parameter: Parameter) -> _Grid:
    low, high, choices = parameter.low, parameter.high, parameter.choices
    if parameter.directions:
        return _Grid(np.linspace(0.0, 360.0, _OCTANTS + 1), _sectors())
    if choices:
        edges = np.linspace(low, high, len(choices) + 1)
        if not is_ordered(parameter):
            return _Grid(edges, None)
        edges = edges[:: -(-len(choices) // _MAX_CELLS)]
        edges = np.append(edges[edges < high], high)
        return _Grid(edges, _ranges(len(edges) - 1))
    if parameter.log or parameter.whole:
        inside = parameter.round_values(2 * _MIN_CELLS)
        if parameter.whole:  # between two whole numbers
            inside = np.unique(np.ceil(inside)) - 0.5
            inside = inside[(inside > low) & (inside < high - 1.0)]
        edges = np.array([low, *inside, high])
        return _Grid(edges, _ranges(len(edges) - 1), parameter)
    step = _round_step((high - low) / _MIN_CELLS)
    first, last = math.floor(low / step + 1e-9) + 1, math.ceil(high / step - 1e-9)
    edges = np.array([low, *(step * i for i in range(first, last)), high])
    return _Grid(edges, _ranges(len(edges) - 1))


def _round_step(maximum: float) -> float:
    power = 10.0 ** math.floor(math.log10(maximum) + 1e-9)
    return float(max(step for step in (1, 2, 5) if step * power <= maximum * (1 + 1e-9)) * power)


@cache
def _ranges(count: int) -> Bools:
    at = np.arange(count)
    inside = [(at >= i) & (at < j) for i in range(count) for j in range(i + 1, count + 1)]
    outside = [(at < i) | (at >= j) for i in range(1, count - 1) for j in range(i + 1, count)]
    return np.array([cells for cells in [*inside, *outside] if not cells.all()])


@cache
def _sectors() -> Bools:
    quarter = np.roll(np.arange(_OCTANTS) < 2, -1)  # from -45 to 45 degrees
    quarters = np.array([np.roll(quarter, 2 * i) for i in range(4)])
    members = np.arange(1, 15)[:, None] >> np.arange(4) & 1
    between = [np.roll(quarter, 2 * i + 1) for i in range(4)]
    return np.concatenate([members @ quarters > 0, between])


def _largest_sets(counts: Floats) -> Bools:
    rank = np.argsort(np.argsort(-counts, kind="stable"), kind="stable")
    sizes = np.arange(1, len(counts))
    largest: Bools = rank < sizes[:, None]
    return largest


def is_ordered(parameter: Parameter) -> bool:
    """Return whether a parameter's choices are consecutive whole numbers."""
    names = parameter.choices
    try:
        numbers = list(map(int, names))
    except ValueError:
        return False
    return numbers == list(range(numbers[0], numbers[0] + len(names)))


def condition(parameter: Parameter, edges: Floats, cells: Bools) -> Condition:
    """Return the condition that a parameter lies in some cells of its range, (k,).

    Cell i lies between the physical values i and i + 1 of `edges`, (k + 1,). Those of an angle that
    goes all around are eight equal ones.
    """
    said = f"{short_label(parameter)} is {_describe(parameter, edges, cells)}"
    ranges = tuple((float(edges[i]), float(edges[j])) for i, j in _runs(cells))
    return Condition(parameter=parameter.name, ranges=ranges, text=in_one_line(said))


def short_label(parameter: Parameter) -> str:
    """Say what it is whose parameter is said: the camera, where it is the camera's azimuth."""
    return parameter.label.removesuffix(" azimuth") if parameter.directions else parameter.label


def in_one_line(text: str) -> str:
    """Escape line breaks and control characters."""
    return plain(text)


def _runs(cells: Bools) -> list[tuple[int, int]]:
    changes = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(np.int8), [0]])))
    return [(int(i), int(j)) for i, j in changes.reshape(-1, 2)]


def _describe(parameter: Parameter, edges: Floats, cells: Bools) -> str:
    names = parameter.choices
    if parameter.directions:
        return _describe_directions(parameter.directions, cells)
    if names and not is_ordered(parameter):
        chosen = [name for name, taken in zip(names, cells, strict=True) if taken]
        others = [name for name, taken in zip(names, cells, strict=True) if not taken]
        return either(chosen) if len(chosen) <= len(others) else f"not {either(others)}"
    if names:
        share = (edges - parameter.low) / (parameter.high - parameter.low)
        first = np.rint(share * len(names)).astype(int).tolist()  # each cell's first choice
        return either([_choices(names, first[i], first[j]) for i, j in _runs(cells)])
    if parameter.whole:
        ends = [parameter.with_unit(number(math.ceil(edge))) for edge in edges]
        lasts = [parameter.with_unit(number(math.floor(edge))) for edge in edges]
        return either([_whole(ends, lasts, i, j) for i, j in _runs(cells)])
    # edges are round numbers; those of a narrow range far from zero need many digits
    rounded = (f"{edge:.12g}".replace("-", "\N{MINUS SIGN}") for edge in edges)
    ends = [parameter.with_unit(text) for text in rounded]
    return either([_interval(ends, i, j) for i, j in _runs(cells)])


def _choices(names: tuple[str, ...], first: int, stop: int) -> str:
    if stop == first + 1:
        return names[first]
    if first == 0:
        return f"at most {names[stop - 1]}"
    if stop == len(names):
        return f"at least {names[first]}"
    return f"{names[first]} to {names[stop - 1]}"


def _whole(starts: list[str], stops: list[str], first: int, last: int) -> str:
    if starts[first] == stops[last]:
        return starts[first]
    if first == 0:
        return f"at most {stops[last]}"
    if last == len(stops) - 1:
        return f"at least {starts[first]}"
    return f"{starts[first]} to {stops[last]}"


def _interval(ends: list[str], first: int, last: int) -> str:
    if first == 0:
        return f"below {ends[last]}"
    if last == len(ends) - 1:
        return f"above {ends[first]}"
    return f"between {ends[first]} and {ends[last]}"


def _describe_directions(names: tuple[str, ...], cells: Bools) -> str:
    # the quarter around direction i has the octants before and after 90 i degrees
    around = [bool(cells[2 * i - 1] and cells[2 * i]) for i in range(4)]
    chosen = [name for name, taken in zip(names, around, strict=True) if taken]
    if not chosen:  # a quarter between two directions
        first = next(i for i in range(4) if cells[2 * i])
        ahead, aside = sorted((first, (first + 1) % 4), key=lambda i: i % 2)
        return f"{names[ahead]} and {names[aside]}"
    if len(chosen) == 3:
        return f"not {names[around.index(False)]}"
    return either(chosen)


def either(parts: Sequence[str]) -> str:
    """Join what may be said of one thing: `fog, rain or snow`."""
    return " or ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
