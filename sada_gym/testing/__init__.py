"""Tools to test an application or an adversary: contracts for pytest, checks, known landscapes.

    from sada_gym.testing import AdversaryContract

    class TestMine(AdversaryContract):
        def make(self, dimension, seed):
            return Mine(dimension, seed=seed)

The names are loaded on first use: the contracts need pytest, `sada-gym check` does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names
from sada_gym.testing.purity import assert_pure

if TYPE_CHECKING:
    from sada_gym.testing.contracts import AdversaryContract, ApplicationContract, RecordingOracle

__all__ = ["AdversaryContract", "ApplicationContract", "RecordingOracle", "assert_pure"]

__getattr__ = lazy_names(__name__, dict.fromkeys(__all__, "contracts"))
