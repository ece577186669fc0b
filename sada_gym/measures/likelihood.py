"""How likely an agent fails in ordinary use: the record of an estimate, and how people read it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import Field

from sada_gym.errors import FileError
from sada_gym.foundations.figures import number, percent
from sada_gym.foundations.files import OneLine, Strict, read_model

ESTIMATE_FILE, DENSITY_FILE = "estimate.json", "density.png"
_ALL_HELD, _OFTEN = 0.995, 0.05


class RiskShare(Strict):
    """How much of the probability lies in a weakness of the diagnosis; number 0 is outside all."""

    number: int
    text: OneLine
    share: float


class ComparedAgent(Strict):
    """Another agent in the same worlds with the same seeds.

    Attributes:
        ratio: How many times as often the first agent fails; None where the other never did.
        ratio_interval: Its 95 % interval; None stands for no bound.
        refused: Why the other agent's probability is not to be relied on, or None.
    """

    agent: OneLine
    probability: float
    interval: tuple[float, float]
    ratio: float | None
    ratio_interval: tuple[float, float | None]
    refused: OneLine | None = None

    @property
    def sentence(self) -> str:
        """The comparison in one line."""
        low, high = self.ratio_interval
        if self.ratio is None and not low:
            return f"{self.agent} did not fail in the same worlds either"
        ends = f"{low:.2g} to {high:.2g}" if high else f"{low:.2g} times or more"
        times = "more often" if self.ratio is None else f"{self.ratio:.2g} times as often"
        write = percent if self.probability >= _OFTEN else odds
        rate, *each = (write(one) for one in (self.probability, *self.interval))
        other = f"{self.agent} ({rate}, {' to '.join(each)}) in the same worlds"
        refused = f". Do not rely on it: {self.refused}" if self.refused else ""
        than = "than" if self.ratio is None else "as"
        return f"fails {times} (95 %: {ends}) {than} {other}{refused}"


class FailureEstimate(Strict):
    """The probability that an agent fails in ordinary use, over worlds and seeds.

    Attributes:
        probability: The estimate.
        interval: Its 95 % interval.
        queries: The evaluations of this call, without the queries of a run.
        method: The method of the estimate, in words.
        refused: Why the estimate must not be trusted; None if nothing speaks against it.
        held: The share of ordinary use that lies in the ranges; the rest is left out.
        drawn: The number of valid fresh draws in the estimate.
        failures: How many of the draws failed.
        plain: How many of the draws come from ordinary use, not from where failures are expected.
        plain_failures: How many plain draws failed.
        effective: The estimate is as certain as plain draws with this many failures would make it.
        unseen: A region of failures that all queries and plain draws missed has at most this
            probability, with 95 % confidence.
        shares: How much of the probability lies in each weakness of the run's diagnosis, the
            largest first; empty without a diagnosis.
        density: The density of ordinary use.
        seed: The seed of all draws.
        to_halve: About how many more queries halve the interval.
        beside: The comparison with another agent, if one was given.
        per: The summary says how many of this many episodes fail.
        unit: What the summary calls an episode, such as `flights`.
    """

    probability: float
    interval: tuple[float, float]
    queries: int
    method: OneLine
    refused: OneLine | None
    held: float
    drawn: int
    failures: int
    plain: int
    plain_failures: int
    effective: float
    unseen: float
    shares: tuple[RiskShare, ...] = ()
    density: dict[str, Any]
    seed: int
    to_halve: int | None = None
    beside: ComparedAgent | None = None
    per: int | None = Field(default=None, ge=1)
    unit: OneLine | None = None

    @property
    def sentence(self) -> str:
        """The estimate in one line, as a safety case takes it."""
        low, high = self.interval
        if not self.failures:
            return f"no failure in {self.drawn:,} worlds: below {odds(high)} with 95 %"
        if self.probability >= _OFTEN:
            ends = f"{percent(low)} to {percent(high)}"
            return f"fails in {percent(self.probability)} of ordinary worlds (95 %: {ends})"
        ends = f"{odds(low)} to {odds(high)}"
        return f"fails in {odds(self.probability)} ordinary worlds (95 %: {ends})"

    @property
    def basis(self) -> str:
        """What the estimate rests on, in a sentence or two."""
        text = (
            f"{self.method}, {self.queries:,} queries; {self.failures:,} of {self.drawn:,} fresh "
            "draws failed"
        )
        if self.plain < self.drawn and self.probability < _OFTEN:
            text += f", as informative as {self.effective:,.0f} failures of plain draws"
        if self.held < _ALL_HELD:
            text += f"; the ranges hold {percent(self.held)} of ordinary worlds"
        return (
            f"{text}. A failure region that no query met could have a "
            f"probability of up to {odds(self.unseen)} (95 %)"
        )

    def _in_use(self) -> str:
        unit, many = self.unit or "episodes", self.per or 1_000
        some, low, high = (number(many * one) for one in (self.probability, *self.interval))
        if not self.probability:
            return f"of {many:,} {unit} fewer than {high} fail (95 %)"
        told = f"of {many:,} {unit} {some} fail (95 %: {low} to {high})"
        times = round(1.0 / self.probability)
        return f"{told}, one failure in {times:,} {unit}" if times > 1 else told

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the name and the text of each finding, as the summary of a run has them."""
        refused = "" if self.refused is None else f". Do not rely on it: {self.refused}"
        yield "in ordinary use", f"{self.sentence}{refused}"
        if self.beside is not None:
            yield "compared", self.beside.sentence
        if self.per is not None or self.unit is not None:
            yield "in use", self._in_use()
        yield "based on", self.basis
        if self.to_halve:
            yield "to halve this interval", f"about {self.to_halve:,} more queries"
        if self.shares:
            listed = [
                f"{percent(share.share)} {f'where {share.text}' if share.number else 'elsewhere'}"
                for share in self.shares[:4]
            ]
            yield "of this risk", "; ".join(listed)


def odds(probability: float) -> str:
    """Write a small probability as people read it, `1 of 9,400`."""
    if not probability > 0.0:
        return "0"
    if probability > _OFTEN:
        return percent(probability)
    times = 1.0 / probability
    digits = 10 ** max(0, len(str(int(times))) - 2)
    return f"1 of {round(times / digits) * digits:,}"


def estimated_before(run: Path) -> FailureEstimate | None:
    """Read the estimate in a run's folder; None where there is none, or it cannot be read."""
    with suppress(FileError):
        return read_model(run / ESTIMATE_FILE, FailureEstimate)
    return None
