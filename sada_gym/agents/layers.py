"""Parts of networks as kernels: the bits depend neither on BLAS nor on the processor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel

_MOST = 600.0
"""The greatest exponent, far beyond all that occur."""
_POWERS = np.array([2.0**power for power in range(-900, 901)])
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""The logarithm of 2 in two parts; the first has few digits, so that its multiples are exact."""
_TERMS = np.array([1.0 / math.factorial(n) for n in range(13, -1, -1)])


@kernel
def dense(inputs: Floats, weights: Floats, biases: Floats) -> Floats:
    """Return the outputs (m,) for inputs (n,), weights (n, m) and biases (m,)."""
    outputs = biases.copy()
    for k in range(len(inputs)):
        for unit in range(len(outputs)):
            outputs[unit] += weights[k, unit] * inputs[k]
    return outputs


def forward(
    inputs: Floats, layers: Iterable[tuple[Floats, Floats]], activate: Callable[[Floats], None]
) -> Floats:
    """Return what layers of weights and biases make of inputs (n,).

    `activate` is applied in place after each layer but the last.
    """
    outputs = inputs
    for k, layer in enumerate(layers):
        if k:
            activate(outputs)
        outputs = dense(outputs, *layer)
    return outputs


@kernel
def exponential(x: float) -> float:
    """Return e to the x by sums and products alone, so that the bits are the same everywhere.

    It is off by one in the last place at most; exponents beyond 600 are cut off.
    """
    x = min(max(x, -_MOST), _MOST)
    power = math.floor(x * 1.4426950408889634 + 0.5)
    rest = (x - power * _LN2_HIGH) - power * _LN2_LOW
    value = 0.0
    for k in range(14):
        value = value * rest + _TERMS[k]
    return float(value * _POWERS[int(power) + 900])
