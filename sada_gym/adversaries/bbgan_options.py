"""The options of BBGAN: the paper's setting and ours, as named presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from sada_gym.errors import UserError


@dataclass(frozen=True)
class BBGANOptions:
    """What a BBGAN can be told. The defaults are ours; `PAPER` is the paper's setting.

    Attributes:
        latent: Dimensions of z.
        generator: Widths of the generator's hidden layers.
        discriminator: Widths of the discriminator's hidden layers.
        transport: Whether the generator moves uniform points (it starts as the uniform
            distribution, so no region is missed from the outset) or maps z alone.
        fold: Whether outputs are folded back at the box's faces, which they reach as often as any
            other place, instead of squashed by tanh, which hardly ever reaches them.
        features: Random Fourier features of mu that both networks see; 0 for mu alone.
        frequency: Their scale, divided by d: without them small networks blur what is narrow.
        initial_sd: Standard deviation of truncated normal weights; 0 for PyTorch's own scale.
        steps: Training steps.
        batch: Samples of each kind in an update.
        discriminator_updates: Discriminator updates a step.
        generator_updates: Generator updates a step.
        learning_rate: Adam's.
        decay: Whether the learning rate falls linearly to 0 over the second half.
        beta1: Adam's.
        beta2: Adam's.
        dropout: In the discriminator: it must not learn a noisy Omega by heart.
        induced_size: s, the most points of the induced set; 0 for all that fool.
        rest: How much the points of Omega that do not fool count against the induced set as further
            fakes: at most this, at most their number over that of S; 0 for not at all.
        tether: Price of moving a uniform point, times the squared distance: a point that starts in
            a fooling region stays, and none of the regions is left. Needs `transport`.
        average: Decay of the running average of both networks' weights; 0 for the last weights.
        acceptance: The share of samples that the discriminator may refuse: a sample is kept with
            probability min(1, r / r_a), r its odds of being real, r_a their quantile at this share.
    """

    latent: int = 8
    generator: tuple[int, ...] = (128, 128)
    discriminator: tuple[int, ...] = (256, 256)
    transport: bool = True
    fold: bool = True
    features: int = 32
    frequency: float = 4.0
    initial_sd: float = 0.0
    steps: int = 600
    batch: int = 128
    discriminator_updates: int = 1
    generator_updates: int = 1
    learning_rate: float = 2e-3
    decay: bool = True
    beta1: float = 0.5
    beta2: float = 0.99
    dropout: float = 0.3
    induced_size: int = 0
    rest: float = 3.0
    average: float = 0.99
    tether: float = 1.0
    acceptance: float = 0.9

    def __post_init__(self) -> None:
        """Check every option.

        Raises:
            ValueError: If one is of another type than its default's, or out of range.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, tuple) and isinstance(value, list):
                object.__setattr__(self, field.name, value := tuple(value))
            if isinstance(field.default, float) and type(value) is int:
                object.__setattr__(self, field.name, value := float(value))
            low, high = _RANGES.get(field.name, (None, None))
            _check(field.name, value, field.default, low, high)


_RANGES: dict[str, tuple[float, float]] = {
    "latent": (1, 1024),
    "generator": (1, 4096),
    "discriminator": (1, 4096),
    "features": (0, 4096),
    "frequency": (0.0, 1e3),
    "initial_sd": (0.0, 10.0),
    "steps": (1, 10**7),
    "batch": (1, 10**6),
    "discriminator_updates": (1, 100),
    "generator_updates": (1, 100),
    "learning_rate": (1e-8, 1.0),
    "beta1": (0.0, 0.9999),
    "beta2": (0.0, 0.9999),
    "dropout": (0.0, 0.95),
    "induced_size": (0, 10**9),
    "rest": (0.0, 1e6),
    "average": (0.0, 0.99999),
    "tether": (0.0, 1e3),
    "acceptance": (0.0, 0.99),
    "stages": (0, 100),
    "share": (0.001, 10.0),
    "copies": (1, 1000),
}

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
"""The paper's setting, where the paper is silent the authors' code's."""


_NAMES = {int: "an int", float: "a float", bool: "true or false"}


def _check(name: str, value: Any, default: Any, low: float | None, high: float | None) -> None:
    many = isinstance(default, tuple)
    kind = int if many else type(default)
    values = value if many and isinstance(value, tuple) else (value,)
    fits = isinstance(value, tuple) == many and all(type(v) is kind for v in values)
    if fits and low is not None and high is not None:
        fits = all(math.isfinite(v) and low <= v <= high for v in values)
    if not fits:
        what = f"a list of {kind.__name__}s" if many else _NAMES[kind]
        between = "" if low is None else f" from {low:g} to {high:g}"
        raise UserError(f"Expected {name} to be {what}{between}, such as {default}; got {value!r}.")
