"""Measures refuse masked arrays: NumPy would count what the mask hides."""

import numpy as np
import pytest

from sada_gym.measures.collapse import collapse_flag
from sada_gym.measures.coverage import density_and_coverage, fooling_coverage
from sada_gym.measures.novelty import novelty
from sada_gym.measures.rates import attack_fooling_rate, mu_std, nearest_neighbours
from sada_gym.measures.search import anytime
from sada_gym.measures.statistics import estimate, interquartile_mean

MU = np.zeros((8, 2))
MASKED = np.ma.masked_array(MU, mask=MU == 0)


@pytest.mark.parametrize(
    "measure",
    [
        lambda: attack_fooling_rate(MASKED[:, 0], 0.3),
        lambda: mu_std(MASKED),
        lambda: nearest_neighbours(MU, MASKED),
        lambda: novelty(MASKED, MU),
        lambda: collapse_flag(MASKED),
        lambda: density_and_coverage(MASKED, MU),
        lambda: fooling_coverage(MU, MU, MASKED[:, 0] == 0),
        lambda: anytime(MU, MASKED[:, 0], 0.3, None, (1,)),
        lambda: interquartile_mean(MASKED[:, 0]),
        lambda: estimate(MASKED),
    ],
)
def test_a_mask_is_refused(measure):
    with pytest.raises(TypeError, match="without a mask"):
        measure()
