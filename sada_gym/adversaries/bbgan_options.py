"""The options of BBGAN: the paper's setting and ours, as named presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sada_gym.adversaries.options import Options, option


@dataclass(frozen=True)
class BBGANOptions(Options):
    """The options of `bbgan`. The defaults are ours; the `paper` preset has the paper's settings.

    Attributes:
        latent: The number of dimensions of the latent vector z.
        generator: The widths of the generator's hidden layers.
        discriminator: The widths of the discriminator's hidden layers.
        transport: Whether the generator moves uniform points or maps only z. A generator that
            moves uniform points starts as the uniform distribution, which covers every region.
        fold: Whether outputs are folded back at the box's faces, which they then reach as often as
            other places. Otherwise tanh squashes them, and they hardly ever reach the faces.
        features: The number of random Fourier features of mu for both networks; 0 for only mu.
        frequency: The scale of these features, times d. Without them small networks blur regions.
        initial_sd: The standard deviation of the initial weights; 0 for PyTorch's own scale.
        steps: The number of training steps.
        batch: The number of samples of each kind in an update.
        discriminator_updates: The discriminator's updates in each training step.
        generator_updates: The generator's updates in each training step.
        learning_rate: The learning rate of Adam.
        beta1: The decay rate of Adam's first moment.
        beta2: The decay rate of Adam's second moment.
        decay: Whether the learning rate falls linearly to 0 over the second half.
        dropout: The dropout of the discriminator, which keeps it from memorising a noisy Omega.
        induced_size: s, the largest size of the induced set S; 0 for all points that fool.
        rest: The weight of the points of Omega that do not fool, as further fakes. It is at most
            their number divided by that of S; 0 leaves them out.
        tether: The cost of moving a uniform point, per squared distance. It keeps points in the
            fooling region where they start, so that no region is lost. It needs `transport`.
        average: The decay of the running average of both networks' weights; 0 for no average.
        acceptance: A sample is kept with probability min(1, r / q). r are the odds, by the
            discriminator, that it is real; q is the quantile of r at this share. 0 keeps all.
    """

    latent: int = option(8, 1, 1_024)
    generator: tuple[int, ...] = option((128, 128), 1, 1_024, max_items=32)
    discriminator: tuple[int, ...] = option((256, 256), 1, 1_024, max_items=32)
    transport: bool = True
    fold: bool = True
    features: int = option(32, 0, 4_096)
    frequency: float = option(4.0, 0, 1e3)
    initial_sd: float = option(0.0, 0, 10)
    steps: int = option(600, 1, 10**7)
    batch: int = option(128, 1, 16_384)
    discriminator_updates: int = option(1, 1, 100)
    generator_updates: int = option(1, 1, 100)
    learning_rate: float = option(2e-3, 1e-8, 1)
    decay: bool = True
    beta1: float = option(0.5, 0, 0.9999)
    beta2: float = option(0.99, 0, 0.9999)
    dropout: float = option(0.3, 0, 0.95)
    induced_size: int = option(0, 0, 10**9)
    rest: float = option(3.0, 0, 1e6)
    average: float = option(0.99, 0, 0.99999)
    tether: float = option(1.0, 0, 1e3)
    acceptance: float = option(0.9, 0, 0.99)


PAPER: dict[str, Any] = {
    "latent": 17,
    "generator": (10, 10, 10, 10),
    "discriminator": (10, 10, 10),
    "transport": False,
    "fold": False,
    "features": 0,
    "initial_sd": 0.01,
    "steps": 600,
    "batch": 64,
    "discriminator_updates": 1,
    "generator_updates": 2,
    "learning_rate": 2e-4,
    "decay": False,
    "beta1": 0.5,
    "beta2": 0.999,
    "dropout": 0.0,
    "induced_size": 100,
    "rest": 0.0,
    "average": 0.0,
    "tether": 0.0,
    "acceptance": 0.0,
}
"""The paper's setting; where the paper is silent, that of the authors' code."""
