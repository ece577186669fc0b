"""The pole before the object: where it stands, what it covers, and how it travels as data."""

import json

import numpy as np
import pytest
from test_renderer import CAR, scene

from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.scene import OCCLUDER_WIDTH, Scene


def render(shift, size=128, **changes):
    return default_renderer().render(scene(CAR, occluder=shift, **changes), size)


def covered(shift, size=128, **changes):
    """The columns that the pole changes."""
    with_pole, without = (render(s, size, **changes).image for s in (shift, None))
    changed = (with_pole != without).any(axis=2)
    columns = np.flatnonzero(changed.any(axis=0))
    assert changed[:, columns].mean() > 0.95  # as high as the picture
    return columns


@pytest.mark.parametrize("pitch", [0.0, 50.0])
@pytest.mark.parametrize("size", [64, 101, 320])
@pytest.mark.parametrize("shift", [-0.8, 0.0, 0.31])
def test_the_pole_covers_its_share_of_the_width_where_it_stands(shift, size, pitch):
    columns = covered(shift, size, camera_pitch_deg=pitch)
    low, high = ((shift + side * OCCLUDER_WIDTH + 1) / 2 * size for side in (-1, 1))
    assert abs(columns.min() - low) <= 1
    assert abs(columns.max() + 1 - high) <= 1


def test_at_the_edges_half_of_the_pole_is_in_sight_and_beyond_them_none():
    assert covered(1.0).min() == 118
    assert covered(-1.0).max() == 9
    np.testing.assert_array_equal(render(1.3).image, render(None).image)


def test_the_true_box_and_mask_are_those_without_the_pole():
    with_pole, without = render(0.0), render(None)
    np.testing.assert_array_equal(with_pole.box, without.box)
    np.testing.assert_array_equal(with_pole.mask, without.mask)
    assert (with_pole.image != without.image)[with_pole.mask].any()


def test_the_pole_is_lit_from_the_lights_side():
    """A light on the left of the camera lights the pole's left half."""
    left, right = (
        render(0.0, light_azimuth_deg=azimuth, light_pitch_deg=10.0).image[64, 55:73].mean(axis=1)
        for azimuth in (-80.0, 80.0)
    )
    assert left[2] > left[-3] + 40
    assert right[2] < right[-3] - 40


def test_the_pole_goes_to_json_and_back_and_scenes_without_one_are_written_as_before():
    this = scene(CAR, occluder=0.25)
    assert json.loads(this.to_json())["occluder"] == 0.25
    again = Scene.from_json(this.to_json())
    assert again.occluder == 0.25
    np.testing.assert_array_equal(
        default_renderer().render(again, 64).image, default_renderer().render(this, 64).image
    )
    without = scene(CAR)
    assert "occluder" not in without.to_dict()
    assert Scene.from_dict(without.to_dict()).occluder is None
