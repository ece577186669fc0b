"""`bbgan`: a generative adversarial network on the induced set (Hamdi, Mueller, Ghanem 2020)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.bbgan_networks import Discriminator, Generator
from sada_gym.adversaries.bbgan_options import PAPER, BBGANOptions
from sada_gym.adversaries.bbgan_training import train_gan
from sada_gym.adversaries.learner import Arrays, Learner, take
from sada_gym.adversaries.omega import Omega
from sada_gym.adversaries.training_log import TrainingLog
from sada_gym.determinism import one_thread

_CALIBRATION_DRAWS = 4096


class BBGAN(Learner):
    """A GAN that learns the fooling distribution from the points of a uniform pool that fool.

    All of the budget goes into Omega. The `paper` preset is the authors' own setting. The `default`
    preset departs from it where it loses whole fooling regions. See `BBGANOptions`.

    The other arguments are those of `Adversary`.

    Args:
        log_dir: Folder for a TensorBoard log of the training; None writes none. It is not saved:
            loading writes no log.

    Raises:
        ModuleNotFoundError: If there is a `log_dir`, but no tensorboard.
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
        self._ceiling = torch.zeros(())

    def train(self, oracle: Query) -> None:
        """Evaluate Omega with all of the budget, induce S, and train the GAN on it.

        Raises:
            TrainingDiverged: If the networks' weights stop being finite.
            ValueError: If there is no budget, or a score is not finite.
        """
        try:
            super().train(oracle)
        finally:
            if self._log:
                self._log.close()

    def _fit(self, omega: Omega) -> None:
        self._seed_networks()
        self._train_networks(omega)

    def _seed_networks(self) -> None:
        self._generator.manual_seed(int(self.rng.integers(2**62)))

    def _train_networks(self, omega: Omega) -> None:
        """Train G and D afresh on the set induced from omega."""
        self.flags = []
        induced = self._induce(omega, self.options.induced_size)
        with one_thread():
            self._g, self._d = train_gan(induced, self.options, self._generator, self._log)
            self._ceiling = self._refusal_ceiling()

    def _refusal_ceiling(self) -> Tensor:
        """Give the logit above which no sample is refused: a quantile over G's own samples."""
        with torch.no_grad():
            logits = self._d(self._g(_CALIBRATION_DRAWS, self._generator))
        return torch.quantile(logits, self.options.acceptance)

    def _propose(self, n: int, noise: float) -> npt.NDArray[np.float32]:
        return self._generate(2 * n + 64, noise)

    def _draw(self, n: int) -> npt.NDArray[np.float32]:
        return self._generate(n, 0.0)

    def _generate(self, n: int, noise: float) -> npt.NDArray[np.float32]:
        """Draw n samples of the generator; without noise, leave out those that D refuses."""
        with torch.no_grad(), one_thread():
            mu = self._g(n, self._generator)
            if noise:
                mu = mu + noise * torch.randn(mu.shape, generator=self._generator)
            elif self.options.acceptance:
                odds = (self._d(mu) - self._ceiling).exp()
                mu = mu[torch.rand(n, generator=self._generator) < odds]
        rows: npt.NDArray[np.float32] = mu.numpy()
        return rows

    def _arrays(self) -> Arrays:
        tensors = {f"generator.{k}": v for k, v in self._g.state_dict().items()}
        tensors |= {f"discriminator.{k}": v for k, v in self._d.state_dict().items()}
        tensors |= {"ceiling": self._ceiling, "random_state": self._generator.get_state()}
        return {name: tensor.numpy() for name, tensor in tensors.items()}

    def _restore(self, arrays: Arrays) -> None:
        self._g = Generator(self.dimension, self.options, self._generator)
        self._d = Discriminator(self.dimension, self.options, self._generator)
        for prefix, network in (("generator.", self._g), ("discriminator.", self._d)):
            own = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
            network.load_state_dict({k: torch.tensor(v) for k, v in own.items()})
        self._ceiling = torch.tensor(take(arrays, "ceiling"))
        self._generator.set_state(torch.tensor(take(arrays, "random_state", None)))
