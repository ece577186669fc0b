"""Estimates a small probability of failure: learn where failures are, then count fresh draws there.

The last draws are fresh: worlds in proportion to their density and the predicted chance, beside
plain draws of ordinary use. Their exact weights make the estimate unbiased however wrong the
predictions are (Dubourg and Sudret 2011; the balance heuristic: Veach and Guibas 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr

from sada_gym.analyses.estimation.interval import exact_interval, gamma_interval
from sada_gym.analyses.estimation.model import FailureModel, Scale
from sada_gym.analyses.estimation.proposal import SCALES, Model, Proposal, Use, stretched
from sada_gym.foundations.arrays import Bools, Floats, Indices
from sada_gym.foundations.figures import percent
from sada_gym.measures.rates import wilson_interval

FEWEST_LEARNT = 300
"""With fewer queries all of them are plain draws."""

_FIRST, _LAST, _STAGES = 0.2, 0.55, 3
_PLAIN_SHARE, _PLAIN_STAGE = 0.5, 0.1
_WIDTHS, _SHARES = (1.0, 3.0), (0.7, 0.3)
_CANDIDATES, _LAST_CANDIDATES = 3_000, 12_000
_NEIGHBOURS = 5
_FEW = 20  # failures, from which on the model knows the threshold

_LEAST_EFFECTIVE, _Z = 5.0, 1.96
_ALLOWANCE = 0.1  # of the estimate, for failures that the model does not expect
_WIDER, _ROUGH = 1.3, 0.02  # a variance that was estimated, and of candidates, is too small


class Answers(NamedTuple):
    """Scores of n worlds, (n,), and which of them failed and were valid."""

    score: Floats
    failed: Bools
    valid: Bools


Ask = Callable[[Floats, Bools], Answers]
"""Scores n fresh worlds at points, (n, d), of which some, (n,), are plain draws."""

Asked = tuple[Floats, Answers]
"""Points, (n, d), with their answers."""


@dataclass(frozen=True, eq=False)
class Found:
    """A probability of failure, its 95 % interval, and the last draws that tell it.

    Attributes:
        refused: Why the interval is not to be relied on, or None.
        effective: How many failures of plain draws tell as much.
        z: The last draws, (n, d), the first `plain` of which are plain.
        weights: What each of them would add to the probability if it failed, (n,).
        terms: What each of them adds to the probability, (n,).
        failed: Which of them failed, (n,).
        learnt: Whether the last draws were guided by a model.
        pool_variance: What the choice of candidates adds to the variance.
    """

    probability: float
    interval: tuple[float, float]
    refused: str | None
    effective: float
    z: Floats
    weights: Floats
    terms: Floats
    failed: Bools
    plain: int
    learnt: bool
    pool_variance: float

    def counted(self, answers: Answers) -> Found:
        """Count other answers to the same draws, such as those of another agent."""
        given = self.z, self.weights, answers, self.plain, self.pool_variance
        return _found(*given, learnt=self.learnt)


def estimate_probability(
    use: Use,
    ask: Ask,
    threshold: float,
    budget: int,
    rng: np.random.Generator,
    known: Asked | None = None,
) -> Found:
    """Estimate how likely a world of ordinary use fails, by so many queries.

    Args:
        use: The density of ordinary use.
        ask: Scores worlds; a failure has a score of at most the threshold.
        threshold: See above.
        budget: The number of queries.
        rng: Draws worlds.
        known: Further worlds to learn from, drawn anyhow.
    """
    if budget < FEWEST_LEARNT:
        return _counted(use, ask, budget, rng)
    last = int(_LAST * budget)
    first = stretched(use, int(_FIRST * budget), rng)
    inside = np.isfinite(use.log_density(first))
    unstretched = np.resize(SCALES, len(first))[inside] == 1.0
    first = first[inside]
    if not len(first):
        first, unstretched = use.sample(1, rng), np.ones(1, np.bool_)
    asked = [(first, ask(first, unstretched))]
    score, _, valid = asked[0][1]
    scale = Scale(score[valid] if valid.any() else score)
    asked += [] if known is None else [known]
    spent = len(first)
    for left in range(_STAGES, 0, -1):
        count = (budget - last - spent) // left
        plain = int(_PLAIN_STAGE * count)
        model, failures = _learnt(asked, scale, threshold, rng)
        # a model that has seen few failures looks further around
        widths = (1.0 if failures >= _FEW else 2.0, 3.0)
        proposal = Proposal.fitted(use, model, widths, (0.5, 0.5), rng)
        found = proposal.candidates(_CANDIDATES, rng)
        odds = found.ratio * proposal.boost(found.depth)
        rows = _choose(odds, count - plain, rng)
        z = np.concatenate([found.z[rows], use.sample(plain, rng)])
        asked.append((z, ask(z, np.arange(count) >= count - plain)))
        spent += count
    model, failures = _learnt(asked, scale, threshold, rng)
    if not failures:
        return _counted(use, ask, budget - spent, rng)
    return _guided(use, model, ask, budget - spent, rng)


def _counted(use: Use, ask: Ask, count: int, rng: np.random.Generator) -> Found:
    """Count the failures of plain draws."""
    z = use.sample(count, rng)
    answers = ask(z, np.ones(count, np.bool_))
    return _found(z, np.full(count, 1.0 / count), answers, count, 0.0, learnt=False)


def _guided(use: Use, model: Model, ask: Ask, count: int, rng: np.random.Generator) -> Found:
    """Count the failures of draws of which some are guided by a model, by their weights.

    The guided draws are drawn, with replacement, from candidates of known density. Given these the
    weights are exact; `pool_variance` is what the choice of candidates adds.
    """
    proposal = Proposal.fitted(use, model, _WIDTHS, _SHARES, rng)
    plain = int(_PLAIN_SHARE * count)
    guided = count - plain
    found = proposal.candidates(_LAST_CANDIDATES, rng)
    boost = proposal.boost(found.depth)
    value = found.ratio * boost
    rows = _choose(value, guided, rng)
    drawn = use.sample(plain, rng)
    z = np.concatenate([drawn, found.z[rows]])
    depth = np.append(model.depth(drawn), found.depth[rows])
    weights = 1.0 / (guided * proposal.boost(depth) + plain)
    weights[plain:] *= value.mean()
    share = guided * boost / (guided * boost + plain)
    pool_variance = float((found.ratio * share * ndtr(found.depth)).var() / len(share))
    answers = ask(z, np.arange(count) < plain)
    return _found(z, weights, answers, plain, pool_variance, learnt=True)


def _found(
    z: Floats, weights: Floats, answers: Answers, plain: int, pool_variance: float, *, learnt: bool
) -> Found:
    failed = answers.failed
    terms = np.where(failed, weights, 0.0)
    rate, variance = float(terms.sum()), pool_variance
    for part in (terms[:plain], terms[plain:]):
        variance += len(part) * float(part.var(ddof=1)) if len(part) > 1 else 0.0
    if learnt:
        variance = _WIDER * variance + (_ROUGH * rate) ** 2
        # one failure more, which no draw met, could weigh as much as a plain draw. Where that is
        # far above the estimate, nobody can exclude it; the interval then allows for a part of it
        heaviest = 1.0 / plain
        if rate > 0.0:
            allowed = min(heaviest, rate * max(_ALLOWANCE, min(1.0, rate * plain)))
            heaviest = max(float(terms.max()), allowed)
        low, high = gamma_interval(rate, variance, heaviest)
    else:
        low, high = exact_interval(int(failed.sum()), len(z))
    effective = rate**2 / variance if variance > 0.0 else float((terms > 0.0).sum())
    refused = None
    if learnt and failed.any() and effective < _LEAST_EFFECTIVE:
        share = float(terms.max()) / rate if rate else 1.0  # the weights of all underflowed
        refused = (
            f"it is as informative as {effective:.0f} failures of plain draws, and "
            f"{percent(share)} of it comes from one draw. Raise the budget"
        )
    valid = int(answers.valid[:plain].sum())
    if valid < plain:
        # invalid worlds are none of ordinary use
        ends = wilson_interval(valid, plain)
        rate, low, high = rate * plain / max(valid, 1), low / ends[1], high / max(ends[0], 1e-9)
    interval = (min(low, 1.0), min(high, 1.0))
    return Found(
        min(rate, 1.0), interval, refused, effective, z, weights, terms, failed, plain, learnt,
        pool_variance,
    )  # fmt: skip


def ratio_of(one: Found, other: Found) -> tuple[float | None, tuple[float, float | None]]:
    """Return how many times as likely one agent fails as another in common draws, and its interval.

    None stands for no bound. The draws are common, so that luck with them cancels (delta method on
    the logarithm); with few failures the ends of both intervals are divided, which is wider.
    """
    if not other.probability:
        low = one.interval[0] / other.interval[1]
        return None, (low, None)
    ratio = one.probability / other.probability
    if min(one.effective, other.effective) < _LEAST_EFFECTIVE:
        least = other.interval[0]
        high = one.interval[1] / least if least else None
        return ratio, (one.interval[0] / other.interval[1], high)
    difference = one.terms / one.terms.sum() - other.terms / other.terms.sum()
    parts = (difference[: one.plain], difference[one.plain :])
    variance = sum(len(part) * float(part.var(ddof=1)) for part in parts if len(part) > 1)
    factor = float(np.exp(_Z * np.sqrt(_WIDER * variance + 2.0 * _ROUGH**2)))
    return ratio, (ratio / factor, ratio * factor)


def _learnt(
    asked: Sequence[Asked], scale: Scale, threshold: float, rng: np.random.Generator
) -> tuple[Model, int]:
    """Fit a model to all valid answers, and count the failures among them."""
    valid = np.concatenate([answers.valid for _, answers in asked])
    points = np.concatenate([z for z, _ in asked])
    z = points[valid]
    score = np.concatenate([answers.score for _, answers in asked])[valid]
    failed = np.concatenate([answers.failed for _, answers in asked])[valid]
    # between the scores that fail and the others: scores may leave a gap there
    low = float(score[failed].max()) if failed.any() else threshold
    high = float(score[~failed].min()) if not failed.all() else threshold
    level = float(scale(np.array([threshold, (low + high) / 2.0])).mean())
    model: Model = FailureModel(z, scale(score), failed, level, rng)
    if int((~valid).sum()) >= _NEIGHBOURS:
        model = _OfValid(model, points, valid)
    return model, int(failed.sum())


class _OfValid:
    """A model that expects no failure where most of the nearest worlds were invalid."""

    def __init__(self, model: Model, z: Floats, valid: Bools) -> None:
        self._model, self._valid, self._tree = model, valid, cKDTree(z)

    def depth(self, z: Floats) -> Floats:
        """Return how deep a failure is expected, (n,), maybe -inf."""
        depth = self._model.depth(z)
        if len(z):
            rows = self._tree.query(z, _NEIGHBOURS)[1]
            depth[self._valid[rows].mean(axis=1) < 0.5] = -np.inf
        return depth


def _choose(odds: Floats, count: int, rng: np.random.Generator) -> Indices:
    total = odds.sum()
    p = odds / total if total > 0.0 else np.full(len(odds), 1.0 / len(odds))
    return np.asarray(rng.choice(len(odds), count, p=p))
