"""`bbgan`, a generative adversarial network on the induced set, and `bbgan-boost` (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.bbgan_networks import Discriminator, Generator
from sada_gym.adversaries.bbgan_options import PAPER, BBGANOptions
from sada_gym.adversaries.bbgan_training import train_gan
from sada_gym.adversaries.fitted import Arrays, FittedAdversary, validate_array, without_prefix
from sada_gym.adversaries.options import option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform
from sada_gym.adversaries.training_log import TrainingLog
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.determinism import one_thread
from sada_gym.parameters import Mu

_CALIBRATION_DRAWS = 4096


class BBGAN(FittedAdversary):
    """A GAN that learns the fooling distribution from the points of a uniform pool that fool.

    It is the adversary of Hamdi, Mueller & Ghanem 2020. All of the budget goes into Omega. The
    `paper` preset has the authors' own settings, with which whole fooling regions can be lost. The
    `default` preset prevents that. See `BBGANOptions`.

    `log_dir` is a folder for a TensorBoard log of the training. `save` does not keep it: a loaded
    adversary writes no log. The other arguments are those of `Adversary`.

    Raises:
        ModuleNotFoundError: If `log_dir` is given, but tensorboard is not installed.
    """

    name: ClassVar[str] = "bbgan"
    packages = ("torch",)
    uniform_queries: ClassVar[bool] = True
    options_class = BBGANOptions
    presets: ClassVar[Mapping[str, BBGANOptions]] = {
        "default": BBGANOptions(),
        "paper": BBGANOptions(**PAPER),
    }
    options: BBGANOptions

    def __init__(
        self,
        dimension: int,
        *,
        seed: int | None = None,
        preset: str = "default",
        log_dir: str | Path | None = None,
        **options: Any,
    ) -> None:
        super().__init__(dimension, seed=seed, preset=preset, **options)
        self._log = None if log_dir is None else TrainingLog(log_dir)
        self._generator = torch.Generator()
        self._g: Generator
        self._d: Discriminator
        self._ceiling: Tensor

    def train(self, oracle: Query) -> None:
        """Spend the budget on Omega, select S (the points that fool), and train the GAN on it.

        Raises:
            TrainingDiverged: If the networks' weights stop being finite.
            ValueError: If there is no budget, or a score is not finite.
        """
        try:
            super().train(oracle)
        finally:
            if self._log:
                self._log.close()

    def fit(self, queries: Evaluations) -> None:
        self._generator.manual_seed(int(self.rng.integers(2**62)))
        self._train_networks(queries)

    def _train_networks(self, queries: Evaluations) -> None:
        self.flags = []
        induced = self._select_fooling(queries, self.options.induced_size)
        with one_thread():
            self._g, self._d = train_gan(
                induced, self.options, self._generator, self._log, self.on_step
            )
            # the logit above which no sample is refused: a quantile over G's own samples
            with torch.no_grad():
                mu, _ = self._g(_CALIBRATION_DRAWS, self._generator)
                logits = self._d(mu)
            self._ceiling = torch.quantile(logits, self.options.acceptance)

    def draw(self, n: int) -> Mu:
        return self._propose(n, 0.0)

    def _propose(self, n: int, noise: float) -> Mu:
        n = 2 * n + 64
        with torch.no_grad(), one_thread():
            mu, _ = self._g(n, self._generator)
            if noise:
                mu = mu + noise * torch.randn(mu.shape, generator=self._generator)
            elif self.options.acceptance:
                odds = (self._d(mu) - self._ceiling).exp()
                mu = mu[torch.rand(n, generator=self._generator) < odds]
        rows: Mu = mu.numpy()
        return rows

    def arrays(self) -> Arrays:
        tensors = {f"generator.{k}": v for k, v in self._g.state_dict().items()}
        tensors |= {f"discriminator.{k}": v for k, v in self._d.state_dict().items()}
        tensors |= {"ceiling": self._ceiling, "random_state": self._generator.get_state()}
        return {name: tensor.numpy() for name, tensor in tensors.items()}

    def restore(self, arrays: Arrays) -> None:
        self._g = Generator(self.dimension, self.options, self._generator)
        self._d = Discriminator(self.dimension, self.options, self._generator)
        for prefix, network in (("generator.", self._g), ("discriminator.", self._d)):
            weights = without_prefix(arrays, prefix)
            network.load_state_dict({k: torch.tensor(v) for k, v in weights.items()})
        self._ceiling = torch.tensor(validate_array(arrays, "ceiling"))
        self._generator.set_state(torch.tensor(validate_array(arrays, "random_state", None)))


@dataclass(frozen=True)
class BoostOptions(BBGANOptions):
    """The options of `bbgan-boost`, in addition to those of `BBGANOptions`.

    Attributes:
        stages: K, the number of times that samples of the last GAN are added to Omega.
        share: How many are added each time, as a share of N, the number of uniform points.
        copies: How many copies of each sample are added. (The paper's beta N with beta = 0.5 are 5
            copies of 0.1 N samples.) With 1, points are unique.
    """

    stages: int = option(2, 0, 100)
    share: float = option(0.25, 0.001, 10)
    copies: int = option(1, 1, 1_000)


class BoostedBBGAN(BBGAN):
    """Trains BBGAN in stages, each anew on all points, including samples of the stage before.

    All of the budget is spent: N uniform points, and K stages of about share * N samples.
    Samples that did not fool also join Omega, so a wrong region is corrected. The arguments are
    those of `BBGAN`, the options those of `BoostOptions`.
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
        """Return the samples of all stages, which the paper adds to its uniform points."""
        return self.options.stages * round(queries * self.options.share)

    def _train(self, oracle: Query) -> Evaluations:
        uniform, share = split_budget(oracle.remaining, self.options)
        queries = boosted = evaluate_uniform(uniform, self.dimension, oracle, self.rng)
        self.fit(queries)
        for stage in range(self.options.stages if share else 0):
            self._set_queries(queries)
            sampled = evaluate(self._fresh(share), oracle)
            queries += sampled
            for _ in range(self.options.copies):
                boosted += sampled
            if self._log:
                self._log.start(f"stage{stage + 1}")
            self._train_networks(boosted)
        return queries


def split_budget(budget: int, o: BoostOptions) -> tuple[int, int]:
    """Split a budget B into N and the samples of a stage: N + stages * samples = B."""
    share = int(budget * o.share / (1.0 + o.stages * o.share))
    return budget - o.stages * share, share
