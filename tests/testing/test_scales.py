import numpy as np
import pytest

from sada_gym.testing.scales import scales

SCORES = np.concatenate([[0.0, 1e-12], np.linspace(0.001, 0.999, 500), [1.0 - 1e-12, 1.0]])
EVERY = scales(SCORES)


@pytest.mark.parametrize("scale", EVERY, ids=lambda scale: scale.name)
def test_a_scale_keeps_the_order_and_the_ends(scale):
    mapped = scale.map(SCORES)
    assert (np.diff(mapped) > 0).all()
    assert (mapped[0], mapped[-1]) == (0.0, 1.0)


def test_they_are_what_their_names_say():
    half = {scale.name: float(scale.map(0.5)) for scale in EVERY}
    assert half["Q"] == 0.5
    assert half["Q^4"] == 0.5**4
    assert half["log Q"] == pytest.approx(1.0 + np.log10(0.5) / 9)
    assert half["rank Q"] == pytest.approx(np.mean(SCORES < 0.5), abs=0.01)
