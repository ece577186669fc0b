"""An optimiser of your own against ours: Optuna's TPE and CMA-ES on the digit 3.

    pip install -c constraints.txt '.[examples]'    # Optuna and cmaes
    python examples/compare_optimisers.py

An optimiser gives points, an adversary gives a distribution that is sampled anew. So both get what
the paper gives its Bayesian baseline: a Gaussian mixture fitted to the lowest points that fooled.
Replace the lines between `ask` and `tell` by those of your optimiser.
"""

from __future__ import annotations

import cmaes
import numpy as np
import optuna

from sada_gym import attack
from sada_gym.adversaries.base import Query
from sada_gym.adversaries.gaussian_mixture import MixtureAdversary
from sada_gym.adversaries.models.mixture import fit_best_mixture
from sada_gym.adversaries.query_pool import evaluate
from sada_gym.evaluations import Evaluations

BATCH = 10  # queries at a time
SIZES = (1, 2, 4, 8, 16, 32)  # of the mixtures to try, as `bayesian` does
SEEDS = 3


class Optimiser(MixtureAdversary):
    """Minimises Q, and fits a mixture to the 100 lowest points that fooled."""

    def fit(self, queries: Evaluations) -> None:
        chosen = self._select_fooling(queries, 100).chosen
        self._mixture = fit_best_mixture(chosen, SIZES, self.rng)


class TPE(Optimiser):
    """Optuna's tree-structured Parzen estimator."""

    name = "tpe"
    packages = ("optuna", "scikit-learn")

    def query(self, oracle: Query) -> Evaluations:
        sampler = optuna.samplers.TPESampler(seed=int(self.rng.integers(2**31)))
        study = optuna.create_study(sampler=sampler)
        box = {
            f"mu{i}": optuna.distributions.FloatDistribution(-1, 1) for i in range(self.dimension)
        }
        found = []
        while oracle.remaining:
            trials = [study.ask(box) for _ in range(min(BATCH, oracle.remaining))]
            mu = np.array([[*trial.params.values()] for trial in trials], np.float32)
            found.append(evaluate(mu, oracle))
            for trial, score in zip(trials, found[-1].score, strict=True):
                study.tell(trial, score)
        return Evaluations.joined(found)


class CMAES(Optimiser):
    """CMA-ES, which starts anew at a random point whenever it has converged."""

    name = "cma-es"
    packages = ("cmaes", "scikit-learn")

    def query(self, oracle: Query) -> Evaluations:
        search, found = self._start(), []
        while oracle.remaining:
            if search.should_stop():
                search = self._start()
            points = [search.ask() for _ in range(search.population_size)]
            mu = np.array(points[: oracle.remaining], np.float32)
            found.append(evaluate(mu, oracle))
            if len(mu) == len(points):
                search.tell([*zip(points, found[-1].score.tolist(), strict=True)])
        return Evaluations.joined(found)

    def _start(self) -> cmaes.CMA:
        mean = self.rng.uniform(-1.0, 1.0, self.dimension)
        box = np.tile([-1.0, 1.0], (self.dimension, 1))
        return cmaes.CMA(mean, sigma=0.5, bounds=box, seed=int(self.rng.integers(2**31)))


def main() -> None:
    """Let each attack the same track, and print means over the seeds as a table."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    print("| adversary | AFR, % | coverage, % of ideal |\n| --- | --- | --- |")
    for adversary in ("random", TPE, CMAES, "bayesian", "level-set"):
        name = adversary if isinstance(adversary, str) else adversary.name
        rows = []
        for seed in range(SEEDS):
            out = f"runs/optimisers/{name}-{seed}"
            found = attack(
                "SADA-Digits-3-v0", adversary, budget=1_000, seed=seed, out=out, resume=True
            )
            rows.append([found.result.afr, found.result.relative_coverage or 0.0])
        afr, coverage = 100 * np.mean(rows, axis=0)
        print(f"| `{name}` | {afr:.0f} | {coverage:.0f} |", flush=True)
    print("AFR: the share of 250 new samples that fool the agent")


if __name__ == "__main__":
    main()
