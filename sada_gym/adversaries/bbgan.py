"""`bbgan`: a generative adversarial network on the induced set (Hamdi, Mueller, Ghanem 2020)."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn.functional import softplus
from typing_extensions import Self

from sada_gym.adversaries import refuse_unknown
from sada_gym.adversaries.base import Adversary, Query
from sada_gym.adversaries.bbgan_networks import Discriminator, Generator
from sada_gym.adversaries.bbgan_options import PAPER, BBGANOptions
from sada_gym.adversaries.learner import NONE_FOOLED, fresh_rows, row_keys
from sada_gym.adversaries.omega import Induced, Omega, evaluate_uniform, induce
from sada_gym.adversaries.tensorboard import TrainingLog
from sada_gym.determinism import one_thread
from sada_gym.errors import UserError

_TENSORS, _SETTINGS = "bbgan.safetensors", "bbgan.json"
_CALIBRATION_DRAWS = 4096
_LOG_EVERY = 25


def train_gan(
    induced: Induced, o: BBGANOptions, generator: torch.Generator, log: TrainingLog
) -> tuple[Generator, Discriminator]:
    """Train G and D by the paper's BBGAN objective: S is real, G's samples are fake.

    With `o.rest` the points of Omega that do not fool are fake as well, so that D learns where the
    agent is fooled from all of Omega and not from S alone (compare Asokan & Seelamantula 2020,
    "Teaching a GAN what not to learn"). Where the fooling rate p(mu) is noisy, G is then drawn to
    where p is high and leaves where it is low; without noise its optimum is unchanged.

    Args:
        induced: S, (s, d), and the rest of Omega, (n, d).
        o: The options.
        generator: All randomness.
        log: Hears of losses and samples.

    Returns:
        G and D, their weights averaged over the steps where `o.average` says so.
    """
    real, rest = torch.from_numpy(induced.chosen), torch.from_numpy(induced.rest)
    g = Generator(real.shape[1], o, generator)
    d = Discriminator(real.shape[1], o, generator)
    average_g, average_d = copy.deepcopy(g), copy.deepcopy(d)
    betas = (o.beta1, o.beta2)
    optimiser_g = torch.optim.Adam(g.parameters(), o.learning_rate, betas)
    optimiser_d = torch.optim.Adam(d.parameters(), o.learning_rate, betas)
    weight = min(o.rest, len(rest) / len(real))

    for step in range(o.steps):
        if o.decay:
            rate = o.learning_rate * min(1.0, 2.0 * (1.0 - step / o.steps))
            for group in (*optimiser_g.param_groups, *optimiser_d.param_groups):
                group["lr"] = rate

        for _ in range(o.discriminator_updates):
            with torch.no_grad():
                fake = g(o.batch, generator)
            batches = [_draw(real, o.batch, generator), fake]
            if weight:
                batches.append(_draw(rest, o.batch, generator))
            logits = d(torch.cat(batches), generator).split(o.batch)
            loss_d = softplus(-logits[0]).mean() + softplus(logits[1]).mean()
            if weight:
                loss_d = loss_d + weight * softplus(logits[2]).mean()
            optimiser_d.zero_grad()
            torch.autograd.backward(loss_d)
            optimiser_d.step()

        for _ in range(o.generator_updates):
            fake, shift = g.draw(o.batch, generator)
            loss_g = softplus(-d(fake, generator)).mean()  # non-saturating
            if o.tether:
                loss_g = loss_g + o.tether * shift.square().sum(dim=1).mean()
            optimiser_g.zero_grad()
            torch.autograd.backward(loss_g)
            optimiser_g.step()

        keep = min(o.average, (step + 1) / (step + 10)) if o.average else 0.0
        _average(average_g, g, keep)
        _average(average_d, d, keep)

        if log and (step % _LOG_EVERY == 0 or step == o.steps - 1):
            log.scalars(
                step,
                {
                    "loss/discriminator": float(loss_d.detach()),
                    "loss/generator": float(loss_g.detach()),
                },
            )
            # a generator of their own: a log must not change the result
            shown = torch.Generator().manual_seed(step)
            with torch.no_grad():
                log.samples(step, average_g(500, shown).numpy())
    return average_g, average_d


class BBGAN(Adversary):
    """A GAN that learns the fooling distribution from the points of a uniform pool that fool.

    All of the budget goes into Omega. The `default` preset departs from the paper's where that
    loses whole fooling regions; the `paper` preset is the authors' own setting.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.
        preset: The named set of options to start from: `default` or `paper`.
        log_dir: Folder for a TensorBoard log of the training; None writes none.
        overrides: Single options, see `BBGANOptions`.

    Attributes:
        options: The resolved options.
        omega: All points evaluated in training.
        flags: What a reader of the result must know, such as that no point fooled.

    Raises:
        ValueError: If the dimension, the preset, or an option is unknown or bad.
        ModuleNotFoundError: If there is a `log_dir`, but no tensorboard.
    """

    name: ClassVar[str] = "bbgan"
    uniform_queries: ClassVar[bool] = True
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
        **overrides: Any,
    ) -> None:
        super().__init__(dimension, seed=seed)
        refuse_unknown("preset", [preset], list(self.presets))
        start = self.presets[preset]
        refuse_unknown(f"option of {self.name}", overrides, [f.name for f in fields(start)])
        self.options = replace(start, **overrides)
        self.omega = Omega(np.zeros((0, dimension), np.float32), np.zeros(0))
        self._log = TrainingLog(log_dir)
        self._generator = torch.Generator()
        self._g: Generator | None = None
        self._d: Discriminator | None = None
        self._ceiling = torch.zeros(())
        self._known: set[bytes] = set()

    def train(self, oracle: Query) -> None:
        """Evaluate Omega with all of the budget, induce S, and train the GAN on it.

        Raises:
            ValueError: If there is no budget, or a score is not finite.
        """
        omega = self._evaluate_uniform(oracle.remaining, oracle)
        self._learn(omega, oracle.threshold)
        self._log.close()

    def _evaluate_uniform(self, n: int, oracle: Query) -> Omega:
        """Evaluate Omega, the same for every adversary of one seed; the networks' seed is next."""
        omega = evaluate_uniform(n, self.dimension, oracle, self.rng)
        self._generator.manual_seed(int(self.rng.integers(2**62)))
        return omega

    def _learn(self, omega: Omega, threshold: float) -> None:
        """Train G and D afresh on the set induced from omega."""
        induced = induce(omega, threshold, self.rng, size=self.options.induced_size or None)
        self.flags = [NONE_FOOLED] if induced.fallback else []
        with one_thread():
            self._g, self._d = train_gan(induced, self.options, self._generator, self._log)
            self._know(omega)
            self._ceiling = self._refusal_ceiling(self._g, self._d)

    def _refusal_ceiling(self, g: Generator, d: Discriminator) -> Tensor:
        """Give the logit above which no sample is refused: a quantile over G's own samples."""
        with torch.no_grad():
            logits = d(g(_CALIBRATION_DRAWS, self._generator))
        return torch.quantile(logits, self.options.acceptance)

    def sample(self, n: int) -> npt.NDArray[np.float32]:
        """Draw n fresh mu from the generator: (n, d) float32 in [-1, 1], no two equal, no query.

        Raises:
            RuntimeError: If it was neither trained nor loaded.
        """
        if self._g is None or self._d is None:
            raise RuntimeError("Expected a trained adversary; call train or load first.")
        g, d = self._g, self._d

        def propose(missing: int, stir: float) -> npt.NDArray[np.float32]:
            return self._propose(g, d, 2 * missing + 64, stir)

        return fresh_rows(propose, (n, self.dimension), self._known)

    def _propose(
        self, g: Generator, d: Discriminator, n: int, stir: float
    ) -> npt.NDArray[np.float32]:
        """Draw n samples and leave out those that the discriminator refuses."""
        with torch.no_grad(), one_thread():
            mu = g(n, self._generator)
            if stir:
                mu = mu + stir * torch.randn(mu.shape, generator=self._generator)
            elif self.options.acceptance:
                odds = (d(mu) - self._ceiling).exp()
                mu = mu[torch.rand(n, generator=self._generator) < odds]
        rows: npt.NDArray[np.float32] = mu.numpy()
        return rows

    def _know(self, omega: Omega) -> None:
        self.omega, self._known = omega, row_keys(omega.mu)

    def save(self, folder: Path) -> None:
        """Write networks, Omega and the generator's state (safetensors), and settings (JSON).

        Raises:
            RuntimeError: If it was not trained.
        """
        if self._g is None or self._d is None:
            raise RuntimeError("Expected a trained adversary to save; call train first.")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        tensors = {f"generator.{k}": v for k, v in self._g.state_dict().items()}
        tensors |= {f"discriminator.{k}": v for k, v in self._d.state_dict().items()}
        tensors |= {"ceiling": self._ceiling, "random_state": self._generator.get_state()}
        tensors |= {
            "omega.mu": torch.from_numpy(self.omega.mu),
            "omega.score": torch.from_numpy(self.omega.score),
        }
        save_file({k: v.contiguous() for k, v in tensors.items()}, folder / _TENSORS)
        settings = {
            "adversary": self.name,
            "dimension": self.dimension,
            "options": asdict(self.options),
            "flags": self.flags,
        }
        (folder / _SETTINGS).write_text(json.dumps(settings, indent=2) + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read an adversary that `save` wrote; it samples as the saved one would have gone on.

        Raises:
            ValueError: If the folder holds no such adversary.
        """
        try:
            settings = json.loads((Path(folder) / _SETTINGS).read_text())
            refuse_unknown("saved adversary", [settings["adversary"]], [cls.name])
            adversary = cls(settings["dimension"], seed=0, **settings["options"])
            adversary.flags = [str(flag) for flag in settings["flags"]]
            adversary._restore(load_file(Path(folder) / _TENSORS))
        except (OSError, KeyError, TypeError, ValueError, RuntimeError, SafetensorError) as error:
            raise UserError(
                f"Expected a folder that `{cls.__name__}.save` wrote, got {folder}: {error}"
            ) from error
        return adversary

    def _restore(self, tensors: dict[str, Tensor]) -> None:
        g = Generator(self.dimension, self.options, self._generator)
        d = Discriminator(self.dimension, self.options, self._generator)
        for prefix, module in (("generator.", g), ("discriminator.", d)):
            own = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
            module.load_state_dict(own)
        self._know(Omega(tensors["omega.mu"].numpy(), tensors["omega.score"].numpy()))
        self._ceiling = tensors["ceiling"]
        self._generator.set_state(tensors["random_state"])
        self._g, self._d = g, d


def _draw(points: Tensor, n: int, generator: torch.Generator) -> Tensor:
    """Draw n of the points, (n, d), with repetition."""
    return points[torch.randint(len(points), (n,), generator=generator)]


def _average(running: nn.Module, latest: nn.Module, keep: float) -> None:
    """Move a running average of weights towards the latest ones."""
    with torch.no_grad():
        for old, new in zip(running.parameters(), latest.parameters(), strict=True):
            old.lerp_(new, 1.0 - keep)
