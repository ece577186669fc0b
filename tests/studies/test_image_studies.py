"""The studies of images: which amounts do no harm alone, RandAugment, and the table of repairs."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from studies import image_repair, photos


def test_the_grid_moves_one_condition_at_a_time_and_says_what_is_harmless():
    usual = np.array([0.0, -1.0], np.float32)
    one = photos.severities(SimpleNamespace(nominal=usual))
    assert one.shape == (3 * photos.SEVERITIES, 2)
    assert ((one != usual).sum(axis=1) == 1).all()
    assert_allclose(one[4], [-1.0, -1.0])
    assert_allclose(one[10:, 1], [-0.6, -0.2, 0.2, 0.6, 1.0], atol=1e-6)
    fooled = np.zeros((20, len(one)), np.bool_)
    fooled[:2, 8] = True  # a tenth of its worlds is still harmless
    fooled[:3, [9, 12]] = True  # what is beyond a harmful amount counts no more
    low, high = photos.harmless(one, fooled, usual)
    assert_allclose(low, [-1.0, -1.0])
    assert_allclose(high, [0.8, -0.2], atol=1e-6)


def test_randaugment_changes_pictures_and_repeats_by_its_generator():
    image = np.random.default_rng(0).integers(0, 256, (32, 32, 3)).astype(np.uint8)
    once = [image_repair.augmented(image, np.random.default_rng(seed)) for seed in range(40)]
    again = [image_repair.augmented(image, np.random.default_rng(seed)) for seed in range(40)]
    assert_array_equal(once, again)
    assert {picture.shape for picture in once} == {image.shape}
    assert sum(bool((picture != image).any()) for picture in once) > 30


def test_the_table_pools_rates_over_seeds():
    row = {"untouched": 0.99, "uniform": 0.5, "fooled": 250, "cvar": 0.1, "attack": 0.9}
    lines = [*image_repair.table({"none": [row, {**row, "attack": 0.8}]})]
    assert lines[2].startswith(
        "| none | 99.0 ± 0.0 | 50.0 ± 0.0 | 10.0 ± 0.0 | 50.0 (46.9 to 53.1)"
    )
    assert lines[2].endswith("85.0 (79.4 to 89.3); 90, 80 |")
