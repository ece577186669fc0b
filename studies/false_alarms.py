"""How often `sada-gym regress` fails an agent that is as good as before, but noisy.

    python -m studies.false_alarms

The agent's noise is its own: no seed fixes it, so that every gate sees other results. 100 gates for
each of two strengths of noise, with and without a baseline. "Before" is the rule of suites of
version 1: the exact test at 5 % in the suite's worlds alone. It takes about a core minute.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from sada_gym import Application, Parameter, ParameterSpace, Scored, attack
from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.regress import regress
from sada_gym.densities import Density, WorldDensity

GATES, SAMPLES = 100, 200


class Noisy(Application):
    """Fails where it is windy and wet, sometimes: noise of the agent's own decides."""

    name = "Noisy"
    fooling_threshold = 0.5
    sample_size = SAMPLES
    parameters = ParameterSpace(Parameter("wind", -4.0, 4.0), Parameter("rain", -4.0, 4.0))
    density = WorldDensity(
        parameters, {name: Density({"normal": [0.0, 1.0]}) for name in parameters.names}
    )

    def __init__(self, trial: int = 0, *, worse: float = 0.0, noise: float = 1.0) -> None:
        self.worse, self.noise = worse, noise
        self.rng = np.random.default_rng(trial)

    def evaluate_batch(self, mu: np.ndarray, seeds: Any) -> Scored:  # noqa: ARG002
        """Score worlds; the seeds fix nothing."""
        margin = 2.2 - self.worse - self.parameters.physical(mu).sum(axis=1) / 2**0.5
        margin = margin + self.noise * self.rng.normal(size=len(mu))
        return Scored(np.clip(0.5 + 0.1 * margin, 0.0, 1.0), [{}] * len(mu))


def noisy_suite(folder: Path, noise: float) -> Path:
    """Attack the agent, and return the path of its suite."""
    agent, again = Noisy(noise=noise), Noisy(1, noise=noise)
    run = attack(agent, "random", budget=0, samples=SAMPLES, pictures=False, out=folder / "run")
    return export(run, folder / "suite", application=again).path


def main() -> None:
    """Print a row for each strength of noise and kind of comparison."""
    print("| noise | compared with | before: fails | now: fails | inconclusive |")
    print("| --- | --- | --- | --- | --- |")
    for noise in (0.5, 1.5):
        with tempfile.TemporaryDirectory() as folder:
            suite = noisy_suite(Path(folder), noise)
            for baseline in (False, True):
                before, status = 0, []
                for trial in range(GATES):
                    old = Noisy(5_000 + trial, noise=noise) if baseline else None
                    result = regress(suite, Noisy(2 + trial, noise=noise), baseline=old)
                    broken, fixed = result.decision.broken, result.decision.fixed
                    if broken > fixed:
                        test = binomtest(broken, broken + fixed, alternative="greater")
                        before += test.pvalue <= 0.05
                    status.append(result.decision.status)
                told = "`--baseline`" if baseline else "the suite's results"
                now = f"{status.count('failed')} | {status.count('inconclusive')}"
                print(f"| {noise} | {told} | {before} | {now} |", flush=True)


if __name__ == "__main__":
    main()
