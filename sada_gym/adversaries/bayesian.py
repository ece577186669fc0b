"""`bayesian`: expected improvement, then a Gaussian mixture on the last points that fool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.expected_improvement import LEAST_CANDIDATES, minimise
from sada_gym.adversaries.gaussian_mixture import MixtureLearner
from sada_gym.adversaries.mixture import fit_best_mixture
from sada_gym.adversaries.omega import Omega, evaluate_uniform, induce
from sada_gym.errors import UserError


class Bayesian(MixtureLearner):
    """Minimises Q by expected improvement, and fits a Gaussian mixture to the lowest late points.

    The Bayesian baseline of the paper (section "Baselines"): its 10^4 steps are whatever budget the
    oracle has; S comes from the last 1,000 evaluations, or from all where there are fewer. Of
    mixtures of several sizes the paper reports the best; ours is the one of the best
    cross-validated likelihood, chosen without a test sample. Draws outside the box are drawn again.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.
        initial: Uniform points that the search starts from, at most the budget. None takes 10 d
            (Jones, Schonlau & Welch 1998), but at most a quarter of the budget.
        last: Evaluations at the end that S is induced from.
        induced_size: s, the most points of S; 0 for all that fool.
        components: Sizes of mixtures to try.
        candidates: Points among which each step chooses, a power of two.
        batch: Points evaluated at once, for parallel workers; see `minimise`.

    Raises:
        ValueError: If an option is out of its range.
    """

    name: ClassVar[str] = "bayesian"

    def __init__(
        self,
        dimension: int,
        *,
        seed: int | None = None,
        initial: int | None = None,
        last: int = 1000,
        induced_size: int = 100,
        components: Sequence[int] = (1, 2, 4, 8, 16, 32),
        candidates: int = 16_384,
        batch: int = 1,
    ) -> None:
        super().__init__(dimension, seed=seed)
        counts = {"last": (last, 1), "induced_size": (induced_size, 0), "batch": (batch, 1)}
        counts |= {f"components[{i}]": (size, 1) for i, size in enumerate(components)}
        if initial is not None:
            counts["initial"] = (initial, 1)
        for what, (count, least) in counts.items():
            if type(count) is not int or count < least:
                raise UserError(f"Expected {what} to be an int of at least {least}, got {count!r}.")
        if not components:
            raise UserError("Expected at least one size among the components, got none.")
        fits = type(candidates) is int and candidates >= LEAST_CANDIDATES
        if not fits or candidates & (candidates - 1):
            raise UserError(
                f"Expected candidates to be a power of two of at least {LEAST_CANDIDATES}, as a "
                f"Sobol sequence wants it, got {candidates!r}."
            )
        self.initial = initial
        self.last = last
        self.induced_size = induced_size
        self.components = tuple(components)
        self.candidates = candidates
        self.batch = batch

    @property
    def options(self) -> dict[str, Any]:
        """The keywords that make an equal adversary."""
        return {
            "initial": self.initial,
            "last": self.last,
            "induced_size": self.induced_size,
            "components": list(self.components),
            "candidates": self.candidates,
            "batch": self.batch,
        }

    def _train(self, oracle: Query) -> Omega:
        budget = oracle.remaining
        initial = self.initial or min(10 * self.dimension, max(budget // 4, 1))
        omega = evaluate_uniform(min(initial, budget), self.dimension, oracle, self.rng)
        omega = minimise(oracle, omega, self.rng, candidates=self.candidates, batch=self.batch)
        late = Omega(omega.mu[-self.last :], omega.score[-self.last :])
        induced = induce(late, oracle.threshold, self.rng, size=self.induced_size or None)
        if induced.fallback:
            self.flags.append(
                f"none of the last {len(late)} points fooled: learnt from the lowest scores instead"
            )
        self._mixture = fit_best_mixture(induced.chosen, self.components, self.rng)
        return omega
