"""`bayesian`: expected improvement, then a Gaussian mixture on the last points that fool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.gaussian_mixture import MixtureLearner
from sada_gym.adversaries.models.expected_improvement import LEAST_CANDIDATES, minimise
from sada_gym.adversaries.models.mixture import fit_best_mixture
from sada_gym.adversaries.omega import Omega, evaluate_uniform, induce
from sada_gym.adversaries.options import Options, option
from sada_gym.errors import UserError


@dataclass(frozen=True)
class BayesianOptions(Options):
    """The options of `bayesian`.

    Attributes:
        initial: Uniform points that the search starts from, at most the budget. None takes 10 d
            (Jones, Schonlau & Welch 1998), but at most a quarter of the budget.
        last: Evaluations at the end that S is induced from.
        induced_size: s, the most points of S; 0 for all that fool.
        components: Sizes of mixtures to try.
        candidates: Points among which each step chooses, a power of two.
        batch: Points evaluated at once, for parallel workers; see `minimise`.
    """

    initial: int | None = option(None, 1, 10**9, kind=int)
    last: int = option(1000, 1, 10**9)
    induced_size: int = option(100, 0, 10**9)
    components: tuple[int, ...] = option((1, 2, 4, 8, 16, 32), 1, 1_000)
    candidates: int = option(16_384, LEAST_CANDIDATES, 2**17)
    batch: int = option(1, 1, 10_000)

    def __post_init__(self) -> None:
        """Check every option.

        Raises:
            ValueError: If one is of another type than declared, or out of range.
        """
        super().__post_init__()
        if self.candidates & (self.candidates - 1):
            raise UserError(
                "Expected candidates to be a power of two, as a Sobol sequence wants it, "
                f"got {self.candidates}."
            )


class Bayesian(MixtureLearner):
    """Minimises Q by expected improvement, and fits a Gaussian mixture to the lowest late points.

    The Bayesian baseline of the paper (section "Baselines"): its 10^4 steps are whatever budget the
    oracle has; S comes from the last 1,000 evaluations, or from all where there are fewer. Of
    mixtures of several sizes the paper reports the best; ours is the one of the best
    cross-validated likelihood, chosen without a test sample. Draws outside the box are drawn again.
    See `BayesianOptions`.
    """

    name: ClassVar[str] = "bayesian"
    options_class = BayesianOptions
    options: BayesianOptions

    def _query(self, oracle: Query) -> Omega:
        o, budget = self.options, oracle.remaining
        initial = o.initial or min(10 * self.dimension, max(budget // 4, 1))
        omega = evaluate_uniform(min(initial, budget), self.dimension, oracle, self.rng)
        return minimise(oracle, omega, self.rng, candidates=o.candidates, batch=o.batch)

    def _fit(self, omega: Omega) -> None:
        o = self.options
        late = Omega(omega.mu[-o.last :], omega.score[-o.last :])
        induced = induce(late, self.threshold, self.rng, size=o.induced_size or None)
        if induced.fallback:
            self.flags.append(
                f"none of the last {len(late)} points fooled: learnt from the lowest scores instead"
            )
        self._mixture = fit_best_mixture(induced.chosen, o.components, self.rng)
