import numpy as np
import pytest

from studies.lucky_landscapes import LuckyLandscape


@pytest.mark.parametrize("shape", ["smooth", "spots"])
def test_the_landscape_fools_as_often_as_it_says(shape):
    landscape = LuckyLandscape(1, shape=shape, dimension=3, inside=0.7, outside=0.1)
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3))
    rate = landscape.fooling_rate(mu)
    assert set(rate) == {0.1, 0.7}
    assert (rate == 0.7).mean() == pytest.approx(0.15, abs=0.05)
    assert (landscape(mu) <= 0.3).mean() == pytest.approx(rate.mean(), abs=0.01)
