"""The record of a diagnosis, which is diagnosis.json in a run's folder."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from pydantic import Field

from sada_gym.errors import FileError
from sada_gym.foundations.files import OneLine, Strict, as_path, read_model, write_model
from sada_gym.measures.rates import Rate

__all__ = [
    "DIAGNOSIS_FILE",
    "VERSION",
    "Diagnosis",
    "Example",
    "Rate",
    "SumCondition",
    "Threshold",
    "Weakness",
    "diagnosed_before",
    "read_diagnosis",
    "write_diagnosis",
]

DIAGNOSIS_FILE = "diagnosis.json"
VERSION = 1

LEAST_FRESH, LEAST_LEAD = 15, 0.15
"""So many fresh worlds in it, and as many outside all rules, confirm a weakness, if its rate is
higher by so much: the lower end of its interval is, than the upper end of the rate elsewhere."""


class Threshold(Strict):
    """An end of a condition's range that is not an end of the parameter's, in physical values.

    With a chance of about 95 % the true end lies in the interval. A sum of two parameters has
    the name `first + 0.5 second`, and the values are those of the sum.
    """

    parameter: str
    value: float
    interval_95: tuple[float, float]


class Condition(Strict):
    """One or more ranges of a parameter, (low, high) in physical values; any of them will do.

    The text is the condition as people say it, such as `camera pitch is above 35°`.
    """

    parameter: str
    ranges: tuple[tuple[float, float], ...]
    text: OneLine


class SumCondition(Condition):
    """A condition on two parameters: on `parameter + factor * other`, in physical values."""

    other: str
    factor: float


class Example(Strict):
    """A failure that stands for others: mu and the seed replay it exactly.

    Attributes:
        parameters: The physical values by name.
    """

    mu: tuple[float, ...]
    seed: int
    score: float
    parameters: dict[str, float]


class Weakness(Strict):
    """A way in which the agent fails: a few conditions on physical parameters.

    Attributes:
        conditions: All of them hold, see `sada_gym.measures.diagnosis.rules.holds`.
        text: The conditions as people say them, such as `camera pitch is above 35° and the camera
            is behind`.
        volume: The share of uniform worlds for which they hold.
        share: The share of the failures for which they hold: among uniform worlds, where enough
            of these failed, else among all that are known.
        failures: The number of known different failures for which they hold.
        distinct: The number of groups of these that wide gaps part.
        inside: The fooling rate of uniform worlds in it, by all worlds whose density is known; None
            where no fresh world was evaluated. Such worlds weigh, so that the rate need not be the
            share of those that fooled.
        outside: The same of worlds that lie in no weakness of the diagnosis.
        fresh: How many fresh worlds checked it: in it, and outside all rules. None in an older
            diagnosis, whose rates are those of fresh worlds alone.
        thresholds: The ends of the ranges, and how sure they are.
        examples: Some failures in it that lie apart, the most typical first.
        confirmed: How often failures in it failed again on fresh seeds; None where not tried.
        behaviour: What the agent does in it; None where not known.
    """

    conditions: tuple[SumCondition | Condition, ...] = Field(min_length=1)
    text: OneLine
    volume: float
    share: float
    failures: int
    distinct: int
    inside: Rate | None
    outside: Rate | None
    fresh: tuple[int, int] | None = None
    thresholds: tuple[Threshold, ...]
    examples: tuple[Example, ...]
    confirmed: Rate | None = None
    behaviour: OneLine | None = None

    @property
    def is_checked(self) -> bool:
        """Whether enough fresh worlds confirmed it, see `LEAST_FRESH`."""
        if self.inside is None or self.outside is None:
            return False
        lead = self.inside.interval_95[0] - self.outside.interval_95[1]
        fresh = self.fresh or (self.inside.samples, self.outside.samples)
        return min(fresh) >= LEAST_FRESH and lead >= LEAST_LEAD


class Diagnosis(Strict):
    """How an agent fails: the weaknesses that a run found, the largest share of failures first.

    Attributes:
        sentence: The diagnosis in one sentence; it says so where failures are too few, or where
            the agent fails nowhere in particular.
        weaknesses: At most five; none where no rule stands out.
        worlds: The number of valid worlds that were known: training queries and test samples.
        failures: The number of different failures among them.
        explained: The share of the failures that lie in any weakness, as `Weakness.share`.
        fresh: The number of evaluations that the diagnosis spent.
    """

    version: int = VERSION
    sentence: OneLine
    weaknesses: tuple[Weakness, ...] = ()
    worlds: int
    failures: int
    explained: float = 0.0
    fresh: int = 0


def write_diagnosis(run: str | Path, diagnosis: Diagnosis) -> Path:
    """Write a diagnosis into the folder of its run, and return the file's path."""
    path = as_path(run, "a run's folder") / DIAGNOSIS_FILE
    write_model(path, diagnosis)
    return path


def read_diagnosis(run: str | Path) -> Diagnosis:
    """Read the diagnosis of a run.

    Raises:
        FileError: If the folder holds none, it is damaged, or another version wrote it.
    """
    path = as_path(run, "a run's folder") / DIAGNOSIS_FILE
    if not path.is_file():
        raise FileError(
            f"Expected a run with a diagnosis in {path.parent}, got no {DIAGNOSIS_FILE} there. "
            f"Make it by `sada-gym diagnose {path.parent}`."
        )
    diagnosis = read_model(path, Diagnosis)
    if diagnosis.version != VERSION:
        raise FileError(
            f"Expected a diagnosis of version {VERSION} in {path}, got version "
            f"{diagnosis.version}. Make it again by `sada-gym diagnose {path.parent}`."
        )
    return diagnosis


def diagnosed_before(folder: Path) -> Diagnosis | None:
    """Return the diagnosis in a run's folder; None where its file is missing or cannot be read."""
    with suppress(FileError):  # such a file is made again
        return read_diagnosis(folder)
    return None
