"""Records of evaluations: mu, score and seed, and whether the agent was fooled."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args, overload

import numpy as np

from sada_gym.foundations.arrays import AnyFloats, Bools, Floats, Indices, Integers
from sada_gym.parameters import Mu

Stream = Literal["train", "test", "validation", "verification"]
"""The purpose of evaluations. Two streams never share a seed."""

UNKNOWN_SEED = -1
"""The seed of an evaluation whose seed is unknown: adversaries are not told the seeds."""

_STREAMS: tuple[str, ...] = get_args(Stream)


@overload
def fools(score: float, threshold: float) -> bool: ...
@overload
def fools(score: AnyFloats, threshold: float) -> Bools: ...
def fools(score: float | AnyFloats, threshold: float) -> bool | Bools:
    """Return whether the agent is fooled, score <= threshold, for one score or an array."""
    fooled = score <= threshold
    return fooled if isinstance(fooled, np.ndarray) else bool(fooled)


@dataclass(frozen=True)
class Evaluations:
    """A record of n evaluations; `evaluations[rows]` selects some, and `+` joins two records.

    `mu` is (n, d); `score`, `seed` and `invalid` are (n,). The mu and the seed of a row repeat its
    evaluation exactly. An invalid world could not be computed; it does not count as a failure.
    """

    mu: Mu
    score: Floats
    seed: Integers
    invalid: Bools = None  # type: ignore[assignment]  # none of them

    def __post_init__(self) -> None:
        """Fill in that no world is invalid."""
        if self.invalid is None:
            object.__setattr__(self, "invalid", np.zeros(len(self.score), np.bool_))

    @classmethod
    def unseeded(cls, mu: Mu, score: Floats) -> Evaluations:
        """Make a record without seeds (all are -1), as adversaries see it."""
        return cls(mu, score, np.full(len(score), UNKNOWN_SEED, np.int64))

    @classmethod
    def empty(cls, dimension: int) -> Evaluations:
        """Make a record without evaluations."""
        return cls(np.zeros((0, dimension), np.float32), np.zeros(0), np.zeros(0, np.int64))

    @classmethod
    def joined(cls, records: Sequence[Evaluations]) -> Evaluations:
        """Join one or more records in this order."""
        return cls(
            np.concatenate([record.mu for record in records]),
            np.concatenate([record.score for record in records]),
            np.concatenate([record.seed for record in records]),
            np.concatenate([record.invalid for record in records]),
        )

    def fooled(self, threshold: float) -> Bools:
        """Return which evaluations fooled the agent, (n,) bool: score <= threshold and valid."""
        return fools(self.score, threshold) & ~self.invalid

    @property
    def valid(self) -> Evaluations:
        """The evaluations of valid worlds only."""
        return self[~self.invalid] if self.invalid.any() else self

    def __len__(self) -> int:
        """Count the evaluations."""
        return len(self.score)

    def __getitem__(self, rows: slice | Bools | Indices) -> Evaluations:
        """Select evaluations."""
        return Evaluations(self.mu[rows], self.score[rows], self.seed[rows], self.invalid[rows])

    def __add__(self, other: Evaluations) -> Evaluations:
        """Join two records."""
        return Evaluations.joined([self, other])


def evaluation_seeds(seed: int, stream: Stream, start: int, count: int) -> list[int]:
    """Return the evaluation seeds of queries `start` to `start + count - 1`, each in [0, 2**31).

    They are a hash of (seed, index) and not draws of a generator, so that a query's seed depends on
    nothing that came before it. The two lowest bits hold the stream, so streams are disjoint.
    """
    texts = (f"{seed}:{i}" for i in range(start, start + count))
    words = (hashlib.blake2b(text.encode(), digest_size=4).digest() for text in texts)
    return [seed_of(word, stream) for word in words]


def seed_of(word: bytes, stream: Stream) -> int:
    """Make an evaluation seed of a stream, in [0, 2**31), from 4 bytes of a hash."""
    return int.from_bytes(word, "big") >> 3 << 2 | _STREAMS.index(stream)
