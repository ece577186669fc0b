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
    """A physical value at which a condition's range ends, inside the parameter's range.

    The true value lies in the interval with a probability of about 95 %. For a sum of two
    parameters, the name is `first + 0.5 second`, and values are those of the sum.
    """

    parameter: str
    value: float
    interval_95: tuple[float, float]


class Condition(Strict):
    """A condition on one parameter: its physical value lies in any of the `ranges`, (low, high).

    The text is the condition in words, such as `camera pitch is above 35°`.
    """

    parameter: str
    ranges: tuple[tuple[float, float], ...]
    text: OneLine


class SumCondition(Condition):
    """A condition on two parameters: a `Condition` on `parameter + factor * other`."""

    other: str
    factor: float


class Example(Strict):
    """A typical failure of a weakness. With mu and the seed it can be replayed exactly.

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
        conditions: The conditions; a world lies in the weakness if all of them hold, see `holds`.
        text: The conditions in words, such as `camera pitch is above 35° and the camera is
            behind`.
        volume: The share of uniform worlds for which they hold.
        share: The share of the failures for which they hold: of the failures in uniform worlds if
            there are enough, otherwise of all known failures.
        failures: The number of different known failures for which they hold.
        distinct: The number of groups into which these failures fall, separated by wide gaps.
        inside: The fooling rate of uniform worlds in it. It is estimated from all worlds, weighted
            by their sampling density, so it may differ from the plain share. None if no fresh world
            was evaluated.
        outside: The same rate for worlds in no weakness.
        fresh: How many fresh worlds checked it: inside it, and outside all rules. None in an older
            diagnosis, whose rates come only from fresh worlds.
        thresholds: The ends of the ranges, with their intervals.
        examples: Some failures in it that differ from one another, the most typical first.
        confirmed: How often failures in it failed again on fresh seeds; None if not tried.
        behaviour: What the agent does in it; None if not known.
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
        """Whether fresh worlds confirmed it: 15 or more on each side, and a clearly higher rate."""
        if self.inside is None or self.outside is None:
            return False
        lead = self.inside.interval_95[0] - self.outside.interval_95[1]
        fresh = self.fresh or (self.inside.samples, self.outside.samples)
        return min(fresh) >= LEAST_FRESH and lead >= LEAST_LEAD


class Diagnosis(Strict):
    """How an agent fails: the weaknesses that a run found, the largest share of failures first.

    Attributes:
        sentence: The diagnosis in one sentence. If there are too few failures, or no rule describes
            them, it says so.
        weaknesses: At most five; empty if no rule describes the failures.
        worlds: The number of valid worlds that it used: training queries and test samples.
        failures: The number of different failures among them.
        explained: The share of failures that lie in any weakness, counted as in `Weakness.share`.
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
