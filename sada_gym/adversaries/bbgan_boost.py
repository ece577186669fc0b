"""`bbgan-boost`: BBGANs in stages, each learning from the last one's samples (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.bbgan import BBGAN
from sada_gym.adversaries.bbgan_options import PAPER, BBGANOptions
from sada_gym.adversaries.omega import evaluate


@dataclass(frozen=True)
class BoostOptions(BBGANOptions):
    """The options of `bbgan`, and of its boosting.

    Attributes:
        stages: K, the number of times that samples of the last GAN join Omega.
        share: How many join each time, as a share of N, the uniform points at the start.
        copies: How often each of them stands in Omega: 5 copies of 0.1 N stand for the paper's
            beta N at beta = 0.5; 1 keeps points unique.
    """

    stages: int = 2
    share: float = 0.25
    copies: int = 1


class BoostedBBGAN(BBGAN):
    """BBGANs in stages, each trained afresh on all points so far, the last one's samples too.

    All of the budget is spent: N uniform points, and K stages of about share * N samples.
    Samples that failed to fool join the rest of Omega: a region has to confirm itself.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.
        preset: The named set of options to start from: `default` or `paper`.
        log_dir: Folder for a TensorBoard log of the training; None writes none.
        overrides: Single options, see `BoostOptions`.

    Attributes:
        options: The resolved options.
        omega: All points evaluated in training.
        flags: What a reader of the result must know, such as that no point fooled.

    Raises:
        ValueError: If the dimension, the preset, or an option is unknown or bad.
        ModuleNotFoundError: If there is a `log_dir`, but no tensorboard.
    """

    name: ClassVar[str] = "bbgan-boost"
    uniform_queries: ClassVar[bool] = False  # stages query the generator's own samples
    presets: ClassVar[Mapping[str, BBGANOptions]] = {
        "default": BoostOptions(),
        "paper": BoostOptions(**PAPER, share=0.1, copies=5),
    }

    def train(self, oracle: Query) -> None:
        """Spend the budget on uniform points and on the samples of each stage's GAN.

        Raises:
            ValueError: If there is no budget, or a score is not finite.
        """
        assert isinstance(self.options, BoostOptions)
        uniform, share = split_budget(oracle.remaining, self.options)
        omega = self._evaluate_uniform(uniform, oracle)
        boosted = omega
        self._learn(omega, oracle.threshold)
        for stage in range(self.options.stages if share else 0):
            sampled = evaluate(self.sample(share), oracle)
            omega += sampled
            for _ in range(self.options.copies):
                boosted += sampled
            self._log.start(f"stage{stage + 1}")
            self._learn(boosted, oracle.threshold)
        self._know(omega)
        self._log.close()


def split_budget(budget: int, o: BoostOptions) -> tuple[int, int]:
    """Split a budget B into N and the samples of a stage: N + stages * samples = B."""
    share = int(budget * o.share / (1.0 + o.stages * o.share))
    return budget - o.stages * share, share
