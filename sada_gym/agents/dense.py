"""A dense layer as a kernel: it adds up in one order, whatever BLAS there is."""

from __future__ import annotations

from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel


@kernel
def dense(inputs: Floats, weights: Floats, biases: Floats) -> Floats:
    """Return the outputs (m,) for inputs (n,), weights (n, m) and biases (m,)."""
    outputs = biases.copy()
    for k in range(len(inputs)):
        for unit in range(len(outputs)):
            outputs[unit] += weights[k, unit] * inputs[k]
    return outputs
