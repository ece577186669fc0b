"""The failures among a run's samples: what the agent does, how sure and how different they are."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sada_gym.errors import FileError
from sada_gym.foundations.arrays import Indices
from sada_gym.foundations.behaviour import Behaviours
from sada_gym.foundations.figures import percent
from sada_gym.foundations.files import OneLine, Strict, as_path, read_model
from sada_gym.measures.rates import Rate

FAILURES_FILE = "failures.json"


class Failure(Strict):
    """A test sample that fooled the agent.

    Attributes:
        sample: Its row in samples.npz.
        parameters: Its physical values by name.
        group: The number of its distinct failure, from 1.
        fooled_seeds: With how many fresh seeds it fooled again, out of the `valid_seeds` with which
            the world is valid; None if it was not tried again.
        behaviour: What the agent did; None if it was not played again.
    """

    sample: int
    mu: tuple[float, ...]
    seed: int
    score: float
    parameters: dict[str, float]
    group: int
    fooled_seeds: int | None = None
    valid_seeds: int | None = None
    behaviour: OneLine | None = None

    @property
    def fails_again(self) -> bool:
        """Whether it fooled with more than half of its valid fresh seeds."""
        return 2 * (self.fooled_seeds or 0) > (self.valid_seeds or 0)


class FailureGroup(Strict):
    """A distinct failure: failing samples of one weakness, without wide gaps between them.

    Attributes:
        failures: The number of samples in it.
        representative: The row of the sample in its middle.
        where: What its worlds have in common, in words.
        weakness: The number of its weakness in the diagnosis, from 1; 0 for samples in no weakness,
            None without a diagnosis.
    """

    failures: int
    representative: int
    where: OneLine
    weakness: int | None = None


@dataclass(frozen=True, eq=False)
class Group:
    """The rows of failures that are one `FailureGroup`, its middle first."""

    rows: Indices
    where: str
    weakness: int | None = None


class Failures(Strict):
    """The contents of failures.json.

    Attributes:
        fooled: How many of the valid samples fooled.
        seeds: The number of fresh seeds on which each failure was tried again; 0 for none.
        confirmed: How many of the failures that were tried again fooled on most of their fresh
            seeds; None without fresh seeds.
        confirmed_afr: The AFR if only confirmed failures count, over all samples up to the last
            failure that was tried.
        behaviours: What the agent did in some failures; None if the application does not say.
        groups: The distinct failures, the largest first; those in no weakness come last.
        failures: The failures: first those that fooled on most fresh seeds, then those with the
            lowest score. If there are very many, only the first samples are listed.
    """

    version: Literal[1] = 1
    fooled: Rate
    seeds: int = 0
    confirmed: Rate | None = None
    confirmed_afr: Rate | None = None
    behaviours: Behaviours | None
    groups: tuple[FailureGroup, ...]
    failures: tuple[Failure, ...]

    @property
    def tried(self) -> int:
        """How many failures were tried again on fresh seeds."""
        return sum(failure.valid_seeds is not None for failure in self.failures)

    @property
    def again(self) -> str:
        """How many failures fail again on fresh seeds, in words."""
        if self.confirmed is None or self.confirmed_afr is None:
            return "failures not yet tried on fresh seeds"
        count, tried = self.confirmed.fooled, self.confirmed.samples
        if tried < self.fooled.fooled:
            return f"{count} of {tried} tried fail again on fresh seeds"
        on = {1: "a fresh seed", 2: "fresh seeds"}.get(
            self.seeds, f"most of {self.seeds} fresh seeds"
        )
        low, high = self.confirmed_afr.interval_95
        rate = f"{percent(self.confirmed_afr.rate)} ({100 * low:.0f} to {100 * high:.0f})"
        return f"{rate} confirmed: {count} of {tried} fail again on {on}"


def read_failures(run: str | Path) -> Failures | None:
    """Read the failures of a run; None if its folder has no failures.json.

    Raises:
        FileError: If the file is damaged, or of another version.
    """
    path = as_path(run, "a run's folder") / FAILURES_FILE
    return read_model(path, Failures) if path.is_file() else None


def listed_before(folder: Path) -> Failures | None:
    """Return the failures that a run's folder lists; None where its file is missing or damaged."""
    with suppress(FileError):  # a damaged file is made again
        return read_failures(folder)
    return None
