"""The networks of BBGAN: small perceptrons that get a generator for all randomness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import leaky_relu, relu

from sada_gym.adversaries.bbgan_options import BBGANOptions


class Perceptron(nn.Module):
    """Linear layers with (leaky) ReLU in between, and dropout where a generator is given."""

    def __init__(self, widths: Sequence[int], *, sd: float, generator: torch.Generator) -> None:
        super().__init__()
        self.plain = sd > 0.0
        self.layers = nn.ModuleList(_linear(i, o, sd, generator) for i, o in pairwise(widths))

    def forward(self, x: Tensor, dropout: float, generator: torch.Generator | None) -> Tensor:
        """Map (batch, in) to (batch, out)."""
        for layer in self.layers[:-1]:
            x = relu(layer(x)) if self.plain else leaky_relu(layer(x), 0.2)
            if dropout and generator is not None:
                kept = torch.rand(x.shape, generator=generator) >= dropout
                x = x * kept / (1.0 - dropout)
        out: Tensor = self.layers[-1](x)
        return out


class Features(nn.Module):
    """mu beside the sines and cosines of random projections (Rahimi & Recht 2007).

    Small networks learn slow functions first; these features show them narrow regions, which are
    narrower in fewer dimensions: the scale is `frequency / d`.
    """

    directions: Tensor

    def __init__(self, dimension: int, o: BBGANOptions, generator: torch.Generator) -> None:
        super().__init__()
        directions = torch.randn(dimension, o.features, generator=generator)
        self.register_buffer("directions", directions * o.frequency / dimension)
        self.width = dimension + 2 * o.features

    def forward(self, mu: Tensor) -> Tensor:
        """Map (batch, d) to (batch, width)."""
        angle = mu @ self.directions
        return torch.cat([mu, angle.cos(), angle.sin()], dim=1)


class Generator(nn.Module):
    """G maps z, and with `transport` a uniform point as well, to mu in [-1, 1]^d."""

    def __init__(self, dimension: int, o: BBGANOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.dimension, self.options = dimension, o
        self.features = Features(dimension, o, generator)
        width = o.latent + (self.features.width if o.transport else 0)
        self.net = Perceptron(
            (width, *o.generator, dimension), sd=o.initial_sd, generator=generator
        )
        if o.transport:
            last = self.net.layers[-1]  # a new generator moves nothing
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw n samples, and say how far each was moved: both (n, d)."""
        z = torch.randn(n, self.options.latent, generator=generator)
        if self.options.transport:
            start = 2.0 * torch.rand(n, self.dimension, generator=generator) - 1.0
            shift = self.net(torch.cat([self.features(start), z], dim=1), 0.0, None)
        else:
            start, shift = torch.zeros(()), self.net(z, 0.0, None)
        mu = start + shift
        return (fold(mu) if self.options.fold else torch.tanh(mu)), shift


class Discriminator(nn.Module):
    """D maps mu to the logit of the probability that it belongs to the induced set."""

    def __init__(self, dimension: int, o: BBGANOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.dropout = o.dropout
        self.features = Features(dimension, o, generator)
        self.net = Perceptron(
            (self.features.width, *o.discriminator, 1), sd=o.initial_sd, generator=generator
        )

    def forward(self, mu: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Map (batch, d) to logits (batch,); with a generator some units are dropped."""
        logits: Tensor = self.net(self.features(mu), self.dropout, generator)
        return logits[:, 0]


def fold(x: Tensor) -> Tensor:
    """Reflect at -1 and 1 until all of x lies between: slope 1 or -1 everywhere."""
    return 1.0 - ((x + 1.0).remainder(4.0) - 2.0).abs()


def _linear(inputs: int, outputs: int, sd: float, generator: torch.Generator) -> nn.Linear:
    # empty first, because a layer's own initialisation draws from the global generator
    layer = nn.Linear(inputs, outputs, device="meta").to_empty(device="cpu")
    if sd:
        nn.init.trunc_normal_(layer.weight, std=sd, a=-2 * sd, b=2 * sd, generator=generator)
        nn.init.zeros_(layer.bias)
    else:
        bound = 1.0 / math.sqrt(inputs)
        nn.init.uniform_(layer.weight, -bound, bound, generator=generator)
        nn.init.uniform_(layer.bias, -bound, bound, generator=generator)
    return layer
