"""The base class of adversaries that learn by reinforcement: rollouts of a policy, and rewards."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import NONE_FOOLED, FittedAdversary
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform
from sada_gym.errors import BudgetTooSmall, TrainingDiverged
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Mu

MEMORY = 1_000
"""The dissimilarity bonus remembers so many failures, the latest ones."""


@dataclass(frozen=True)
class RLOptions(Options):
    """The options of every adversary that learns by reinforcement.

    Attributes:
        uniform_share: At least this share of the budget is uniform. The first rollout's scores are
            ranked among the uniform ones. Queries left over by whole rollouts are uniform, too.
        rollout: The number of queries between two updates of the policy, evaluated together.
        learning_rate: The learning rate of Adam.
        rank: The highest reward of a query that did not fool; a query that fooled gets 1.
        dissimilarity: The weight of the bonus for failures far from those already found.
    """

    uniform_share: float = option(0.1, 0, 1, inside=True)
    rollout: int = option(20, 2, 100_000)
    learning_rate: float = option(0.003, 0, 1, inside=True)
    rank: float = option(0.5, 0, 1)
    dissimilarity: float = option(0.0, 0, 100)


@dataclass(frozen=True)
class PolicySteps:
    """The steps `action`, (n, d), that a policy proposes after it observed where they `start`."""

    start: Floats
    action: Floats

    @property
    def mu(self) -> Mu:
        """The ends of the steps, reflected at the faces of the box: (n, d) in [-1, 1]."""
        return reflect(self.start + self.action).astype(np.float32)


class RLAdversary(FittedAdversary):
    """An adversary whose policy proposes mu, rollout after rollout, and is rewarded for failures.

    An episode is one proposal, so the policy at the first observation is the learnt distribution.
    Rewards depend only on the order of the scores; see `failure_rewards`.

    A subclass implements `begin`, `act`, `learn`, `arrays` and `restore`.
    """

    options: RLOptions

    @abstractmethod
    def begin(self, budget: int) -> None:
        """Make a new policy for a training of `budget` queries."""

    @abstractmethod
    def act(self, n: int) -> PolicySteps:
        """Let the policy propose n steps; take all randomness from the adversary's generator."""

    @abstractmethod
    def learn(self, steps: PolicySteps, rewards: Floats) -> bool:
        """Update the policy after a rollout; return whether all of its weights are finite."""

    def _learn_uniform(self, queries: Evaluations, rewards: Floats) -> None:
        """Learn from the uniform queries, if the algorithm can learn from such actions."""

    def _train(self, oracle: Query) -> Evaluations:
        size, budget = self.options.rollout, oracle.remaining
        rollouts = self._rollouts(budget)
        if rollouts < 1:
            raise BudgetTooSmall(
                f"Expected a budget of at least {self.minimum_budget} queries for {self.name}, got "
                f"{budget}: it needs some uniform queries and a whole rollout of {size}. Raise the "
                "budget, or lower the option rollout."
            )
        queries = evaluate_uniform(budget - rollouts * size, self.dimension, oracle, self.rng)
        self.begin(budget)
        self._learn_uniform(queries, self._rewards(queries, queries[:0]))
        for done in range(rollouts):
            steps = self.act(size)
            if not np.isfinite(steps.action).all():
                raise self._diverged(done)
            asked = evaluate(steps.mu, oracle)
            if not self.learn(steps, self._rewards(asked, queries)):
                raise self._diverged(done + 1)
            queries += asked
        self.fit(queries)
        return queries

    def fit(self, queries: Evaluations) -> None:
        """Set a flag if no query fooled; the policy has already learnt from its rollouts."""
        self.flags = [] if queries.fooled(self.threshold).any() else [NONE_FOOLED]

    @property
    def minimum_budget(self) -> int:
        """The smallest budget, in queries, that it can learn from."""
        budget = math.floor(self.options.rollout / (1.0 - self.options.uniform_share))
        while self._rollouts(budget) < 1:
            budget += 1
        return budget

    def _rollouts(self, budget: int) -> int:
        uniform = max(1, math.ceil(self.options.uniform_share * budget))
        return (budget - uniform) // self.options.rollout

    def _rewards(self, asked: Evaluations, seen: Evaluations) -> Floats:
        o = self.options
        return failure_rewards(
            asked, seen, self.threshold, rank=o.rank, dissimilarity=o.dissimilarity
        )

    def _diverged(self, rollouts: int) -> TrainingDiverged:
        return TrainingDiverged(
            f"Expected the training of {self.name} to stay finite, but the policy's numbers became "
            f"infinite or NaN after {rollouts} rollouts. Lower learning_rate (it is "
            f"{self.options.learning_rate:g})."
        )

    def draw(self, n: int) -> Mu:
        return self.act(n).mu


def failure_rewards(
    asked: Evaluations, seen: Evaluations, threshold: float, *, rank: float, dissimilarity: float
) -> Floats:
    """Return the rewards of a rollout's queries: (n,).

    `asked` are the rollout's queries, `seen` those before it. A query that fooled gets 1, plus
    `dissimilarity` times its `novelties` (Corso et al. 2019, "Adaptive stress testing with reward
    augmentation for autonomous vehicle validation"). Any other gets `rank` times a share: that of
    all queries that missed so far, the rollout's included, whose score is above its own (equal
    scores count half). So only the order of scores matters.
    """
    fooled = asked.fooled(threshold)
    known = seen + asked
    misses = np.sort(known.score[~known.fooled(threshold)])
    places = sum(np.searchsorted(misses, asked.score, side=side) for side in ("left", "right"))
    above = 1.0 - 0.5 * np.asarray(places, np.float64) / max(len(misses), 1)
    rewards: Floats = np.where(fooled, 1.0, rank * above)
    if dissimilarity and fooled.any():
        failures = seen.mu[seen.fooled(threshold)][-MEMORY:]
        rewards[fooled] += dissimilarity * novelties(asked.mu[fooled], failures)
    return rewards


def novelties(mu: Mu, failures: Mu) -> Floats:
    """Return how far each mu (n, d) lies from known failures (m, d): (n,) in [0, 1].

    It is the share of failures whose nearest other failure is closer to them than any failure is to
    the mu. (In many dimensions all points are far apart, so a distance by itself says nothing.)
    With fewer than two failures every mu has novelty 1.
    """
    if len(failures) < 2:
        return np.ones(len(mu))
    tree = KDTree(failures)
    usual = np.sort(tree.query(failures, k=2)[0][:, 1])
    shares: Floats = np.searchsorted(usual, tree.query(mu)[0], side="left") / len(usual)
    return shares
