"""What speaks against a result: each flag is a sentence with its numbers.

A flag needs p < 1e-5 wherever chance has a part. A board has hundreds of results, and an honest one
must not be accused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import binomtest, fisher_exact, norm

from sada_gym.evaluations import Evaluations
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import Experiment
from sada_gym.foundations.arrays import Bools
from sada_gym.foundations.figures import tenths
from sada_gym.measures.collapse import collapse_flag
from sada_gym.measures.reference import Reference, reference_mu
from sada_gym.parameters import Mu

SIGNIFICANCE = 1e-5
"""A flag is raised where an honest result would look so with a smaller probability than this."""

EQUAL = 1e-4
"""Samples count as equal where they differ by at most this in every dimension of [-1, 1]^d."""

MINIMUM_SHARE = 0.1
"""The minimum share of samples that equal others of the result, to be worth a flag."""

MINIMUM_SHARE_OF_OTHERS = 0.5
"""The same for samples of another entry. Adversaries of one seed share uniform points: `random`
draws 22 to 27 % of the samples of `memorise` on the ten digits."""

NEAR_RANK = 0.4
"""Samples may be copied where their mean rank, see `nearness`, is below this."""

MINIMUM_POINTS = 10
"""The minimum number of distinct nearest points whose mean rank means something."""

MINIMUM_EXACT = 2
"""So many samples that are reference points to the last bit are copies; chance makes none."""

OTHER_SETS = 20
"""How many other point sets, made alike, the shipped one is compared with."""

_FIRST_SEED = 1_000_000  # no shipped set has such a seed


@dataclass(frozen=True, eq=False)
class SeedEvidence:
    """The samples of one seed of a result, and the same mu on fresh seeds.

    Attributes:
        again: The same mu on fresh seeds.
        uniform: Uniform samples on the same fresh seeds; None with a reference set.
    """

    seed: int
    samples: Evaluations
    again: Evaluations
    uniform: Evaluations | None


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that flags are found by; `neighbours` are other entries' samples on the track by name."""

    experiment: Experiment
    seeds: Sequence[SeedEvidence]
    reference: Reference | None
    neighbours: Mapping[str, Mu]

    @property
    def mu(self) -> Mu:
        """The samples of all seeds, (n, d)."""
        return np.concatenate([seed.samples.mu for seed in self.seeds])

    @property
    def claimed(self) -> Bools:
        """Which samples fool as claimed, (n,)."""
        return self.fooled([seed.samples for seed in self.seeds])

    @property
    def verified(self) -> Bools:
        """Which samples fool on fresh seeds, (n,)."""
        return self.fooled([seed.again for seed in self.seeds])

    def fooled(self, records: Sequence[Evaluations]) -> Bools:
        """Return which evaluations fooled the agent, (n,)."""
        return Evaluations.joined(records).fooled(self.experiment.target.fooling_threshold)


def find_flags(evidence: Evidence) -> dict[str, str]:
    """Find what speaks against a result, by the flags' names; without samples nothing does."""
    if not evidence.seeds:
        return {}
    sentences: dict[str, str | None] = {}
    checks = {
        "claim": lucky_claim_flag,
        "collapsed": collapsed_flag,
        "constant": constant_flag,
        "copied": copied_flag,
        "duplicates": duplicates_flag,
        "worse than random": worse_than_random_flag,
    }
    if evidence.experiment.adversary.name == IDEAL:
        # this control draws reference points by design
        checks = {"claim": lucky_claim_flag, "constant": constant_flag}
        sentences["control"] = (
            "this control draws its samples from the reference points, so it has no rank"
        )
    sentences |= {name: check(evidence) for name, check in checks.items()}
    return {name: sentence for name, sentence in sentences.items() if sentence is not None}


def lucky_claim_flag(evidence: Evidence) -> str | None:
    """Compare which samples fool as claimed and on fresh seeds, by the sign test on the same mu.

    Rows that agree say nothing. Among the others, an honest claim is the better one as often as
    the worse one.
    """
    claimed, verified = evidence.claimed, evidence.verified
    lost, won = int((claimed & ~verified).sum()), int((~claimed & verified).sum())
    if not lost or binomtest(lost, lost + won, 0.5, alternative="greater").pvalue >= SIGNIFICANCE:
        return None
    return (
        f"{int(claimed.sum()):,} of {len(claimed):,} samples fool the agent as claimed, and "
        f"{int(verified.sum()):,} on fresh seeds: {lost:,} fool only as claimed, {won:,} only on "
        "fresh seeds"
    )


def constant_flag(evidence: Evidence) -> str | None:
    """Find seeds whose claimed Q are one single value while those on fresh seeds are not.

    Where Q is often the same, such as 0, an honest claim may consist of it. Each row that differs
    on the fresh seed could as well have differed in the claim.
    """
    for seed in evidence.seeds:
        values = np.unique(seed.samples.score)
        other = int((seed.again.score != values[0]).sum())
        if len(values) == 1 and len(seed.samples) > 1 and 0.5**other < SIGNIFICANCE:
            return (
                f"all {len(seed.samples):,} samples of seed {seed.seed} have Q = "
                f"{values[0]:.6g} as claimed, and {other:,} of them have another Q on fresh seeds"
            )
    return None


def collapsed_flag(evidence: Evidence) -> str | None:
    """Find seeds whose samples crowd around one point."""
    sentences = [collapse_flag(seed.samples.mu) for seed in evidence.seeds]
    collapsed = [sentence for sentence in sentences if sentence is not None]
    return f"on {len(collapsed)} of {len(sentences)} seeds {collapsed[0]}" if collapsed else None


def copied_flag(evidence: Evidence) -> str | None:
    """Find samples that are reference points, shaken or not, see `nearness`."""
    if evidence.reference is None:
        return None
    near = nearness(evidence.mu, evidence.reference.mu)
    share = near.exact / len(evidence.mu)
    if near.exact >= MINIMUM_EXACT:
        return (
            f"{tenths(share)} of the samples are points of the shipped reference set, to the "
            "last bit"
        )
    if not is_near(near):
        return None
    return (
        f"the samples lie nearer to {near.points:,} points of the shipped reference set than "
        f"chance lets them: other sets that are made alike are farther from them "
        f"{tenths(1.0 - near.mean_rank)} of the time, where 50 % are expected "
        f"(p = {near.p:.0e})"
    )


@dataclass(frozen=True)
class Nearness:
    """How near samples lie to reference points, compared with other sets of the same kind.

    Attributes:
        points: The number of distinct nearest points; one sample of each counts.
        mean_rank: The mean rank, from 0 to 1, of a sample's distance to its nearest point among its
            distances to other sets; about 0.5 for samples that do not come from the points.
        p: The probability that such samples have so low a mean rank, or a lower one.
        exact: The number of samples that are a reference point to the last bit.
    """

    points: int
    mean_rank: float
    p: float
    exact: int


def nearness(mu: Mu, points: Mu, *, seed: int = 0) -> Nearness:
    """Compare how near samples lie to the shipped points and to other sets of the same kind.

    The sets differ in the scrambling of their Sobol sequence alone. So samples that were made
    without the shipped points lie as near to the other sets, wherever they lie. One sample counts
    for each nearest point, because samples that crowd around one place all say the same.

    `mu` is (n, d) float32 in [-1, 1], n >= 1, and `points` are all points of the reference set,
    (R, d) float32, whether they fool or not. The seed fixes the other sets.
    """
    tree = cKDTree(points.astype(np.float64))
    distances, nearest = tree.query(mu.astype(np.float64))
    first = np.sort(np.unique(nearest, return_index=True)[1])
    chosen, own = mu[first].astype(np.float64), distances[first]
    others = np.stack([other.query(chosen)[0] for other in _other_sets(*points.shape, seed)])
    ranks = ((others < own).sum(axis=0) + 0.5 * (others == own).sum(axis=0)) / OTHER_SETS
    deviation = (ranks.mean() - 0.5) / np.sqrt((1.0 + 2.0 / OTHER_SETS) / 12.0 / len(ranks))
    return Nearness(
        points=len(ranks),
        mean_rank=float(ranks.mean()),
        p=float(norm.cdf(deviation)),
        exact=int((distances == 0.0).sum()),
    )


@lru_cache(maxsize=2)
def _other_sets(count: int, dimension: int, seed: int) -> list[Any]:
    first = _FIRST_SEED + seed * OTHER_SETS
    sets = (reference_mu(dimension, count, first + i) for i in range(OTHER_SETS))
    return [cKDTree(mu.astype(np.float64)) for mu in sets]


def is_near(near: Nearness) -> bool:
    """Return whether samples lie nearer to reference points than chance lets them."""
    enough = near.points >= MINIMUM_POINTS
    return enough and near.mean_rank < NEAR_RANK and near.p < SIGNIFICANCE


def duplicates_flag(evidence: Evidence) -> str | None:
    """Find samples that equal others of the result, or of another entry."""
    mu = evidence.mu.astype(np.float64)
    # the nearest is the sample itself
    nearest = cKDTree(mu).query(mu, k=2, p=np.inf)[0][:, 1]
    share = float((nearest <= EQUAL).mean())
    if share >= MINIMUM_SHARE:
        return f"{tenths(share)} of the samples equal another sample of this result"
    for name, others in evidence.neighbours.items():
        distances = cKDTree(others.astype(np.float64)).query(mu, p=np.inf)[0]
        share = float((distances <= EQUAL).mean())
        if share >= MINIMUM_SHARE_OF_OTHERS:
            return f"{tenths(share)} of the samples equal samples of the entry {name}"
    return None


def worse_than_random_flag(evidence: Evidence) -> str | None:
    """Compare the AFR on fresh seeds with that of uniform samples."""
    verified = evidence.verified
    fooled, count = int(verified.sum()), len(verified)
    if evidence.reference is not None:
        rate = evidence.reference.uniform_rate
        p = binomtest(fooled, count, rate, alternative="less").pvalue
    else:
        uniform = evidence.fooled([seed.uniform for seed in evidence.seeds if seed.uniform])
        rate, others = float(uniform.mean()), int(uniform.sum())
        table = [[fooled, count - fooled], [others, len(uniform) - others]]
        p = fisher_exact(table, alternative="less").pvalue
    if p >= SIGNIFICANCE:
        return None
    return (
        f"{tenths(fooled / count)} of the samples fool the agent on fresh seeds, and "
        f"{tenths(rate)} of uniform samples do"
    )
