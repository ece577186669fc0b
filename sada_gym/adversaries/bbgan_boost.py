"""`bbgan-boost`: BBGANs in stages, each learning from the last one's samples (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.bbgan import BBGAN
from sada_gym.adversaries.bbgan_options import PAPER, BBGANOptions
from sada_gym.adversaries.omega import Omega, evaluate, evaluate_uniform
from sada_gym.adversaries.options import option


@dataclass(frozen=True)
class BoostOptions(BBGANOptions):
    """The options of `bbgan`, and of its boosting.

    Attributes:
        stages: K, the number of times that samples of the last GAN join Omega.
        share: How many join each time, as a share of N, the uniform points at the start.
        copies: The number of copies of each sample in Omega: 5 copies of 0.1 N are the paper's
            beta N at beta = 0.5; 1 keeps points unique.
    """

    stages: int = option(2, 0, 100)
    share: float = option(0.25, 0.001, 10)
    copies: int = option(1, 1, 1_000)


class BoostedBBGAN(BBGAN):
    """BBGANs in stages, each trained afresh on all points so far, the last one's samples too.

    All of the budget is spent: N uniform points, and K stages of about share * N samples.
    Samples that failed to fool join the rest of Omega: a region has to confirm itself. The
    arguments are those of `BBGAN`, the options those of `BoostOptions`.
    """

    name: ClassVar[str] = "bbgan-boost"
    uniform_queries: ClassVar[bool] = False  # stages query the generator's own samples
    options_class = BoostOptions
    presets: ClassVar[Mapping[str, BoostOptions]] = {
        "default": BoostOptions(),
        "paper": BoostOptions(**PAPER, share=0.1, copies=5),
    }
    options: BoostOptions

    def extra_queries(self, queries: int) -> int:
        """Count the samples of all stages, which the paper adds to its uniform points."""
        return self.options.stages * round(queries * self.options.share)

    def _train(self, oracle: Query) -> Omega:
        """Spend the budget on uniform points and on the samples of each stage's GAN."""
        uniform, share = split_budget(oracle.remaining, self.options)
        omega = boosted = evaluate_uniform(uniform, self.dimension, oracle, self.rng)
        self._seed_networks()
        self._train_networks(omega)
        for stage in range(self.options.stages if share else 0):
            self._know(omega)
            sampled = evaluate(self._fresh(share), oracle)
            omega += sampled
            for _ in range(self.options.copies):
                boosted += sampled
            if self._log:
                self._log.start(f"stage{stage + 1}")
            self._train_networks(boosted)
        return omega


def split_budget(budget: int, o: BoostOptions) -> tuple[int, int]:
    """Split a budget B into N and the samples of a stage: N + stages * samples = B."""
    share = int(budget * o.share / (1.0 + o.stages * o.share))
    return budget - o.stages * share, share
