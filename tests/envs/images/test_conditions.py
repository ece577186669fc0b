"""Conditions: more of one is never less, none does nothing, and what moves is moved right."""

import numpy as np
import pytest
from image_toys import square
from numpy.testing import assert_array_equal

from sada_gym import Parameter
from sada_gym.envs.images import optics
from sada_gym.envs.images.conditions import (
    CONDITIONS,
    SETS,
    Condition,
    developed,
    find_conditions,
)
from sada_gym.envs.images.geometry import moved_boxes
from sada_gym.errors import UserError

pytest.importorskip("cv2")


@pytest.fixture(scope="module")
def image():
    """A photograph's stand-in: smooth, with edges, fine structure and all brightnesses."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:120, 0:160]
    waves = 0.5 + 0.3 * np.sin(x / 9.0) * np.cos(y / 7.0) + 0.1 * rng.standard_normal((120, 160))
    colours = np.stack([waves, np.abs(waves) ** 1.5, 1.0 - waves], axis=2)
    picture = (255 * np.clip(colours, 0, 1)).astype(np.uint8)
    picture[40:70, 50:90] = (220, 30, 40)
    return picture


def under(image, condition, *values, seed=(1, 2)):
    return developed(image, [condition], [values], seed)


def away(image, condition, *values):
    """How far the image lies from the untouched one, a mean over seeds."""
    seen = [under(image, condition, *values, seed=(seed,)).image for seed in range(4)]
    return np.mean([np.abs(each.astype(float) - image).mean() for each in seen])


@pytest.mark.parametrize("name", CONDITIONS)
def test_more_of_a_condition_is_never_less(image, name):
    condition = CONDITIONS[name]
    first, *others = condition.parameters
    rest = [parameter.values(0.7) for parameter in others]
    usual = first.shares(condition.nominal[0])
    for end in (0.0, 1.0):
        if end == usual:
            continue
        shares = usual + (end - usual) * np.linspace(0.0, 1.0, 7)
        distances = [away(image, condition, float(first.values(share)), *rest) for share in shares]
        assert distances[0] == 0.0
        assert distances[-1] > 0.05
        if condition.moves is None:  # what is moved far is not farther from an image of waves
            assert (np.diff(distances) > -0.05 * distances[-1]).all(), distances


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_repeats_by_its_seed_whatever_else_there_is(image, name):
    condition = CONDITIONS[name]
    values = [tuple(float(p.values(0.8)) for p in each.parameters) for each in CONDITIONS.values()]
    own = values[[*CONDITIONS].index(name)]
    before = under(image, condition, *own).image
    developed(image, [*CONDITIONS.values()], values, (5,))
    assert_array_equal(under(image, condition, *own).image, before)
    assert before.dtype == np.uint8
    assert before.flags.c_contiguous
    off = [each.nominal for each in CONDITIONS.values()]
    off[[*CONDITIONS].index(name)] = own
    assert_array_equal(developed(image, [*CONDITIONS.values()], off, (1, 2)).image, before)


@pytest.mark.parametrize("shape", [(2, 2, 3), (7, 301, 3), (300, 5, 3)])
@pytest.mark.parametrize("share", [0.02, 0.5, 1.0])
def test_images_of_any_shape_can_be_seen_under_all_conditions(shape, share):
    odd = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    values = [tuple(float(p.values(share)) for p in c.parameters) for c in CONDITIONS.values()]
    assert developed(odd, [*CONDITIONS.values()], values, (0,)).image.shape == shape


@pytest.mark.parametrize(
    ("names", "values"),
    [
        (["rotation"], [(15.0,)]),
        (["zoom"], [(0.6,)]),
        (["distortion"], [(0.15,)]),
        (["distortion"], [(-0.15,)]),
        (["rotation", "zoom", "distortion"], [(-12.0,), (1.4,), (0.15,)]),
    ],
)
def test_boxes_go_where_their_objects_go(names, values):
    image = square(60, 40, 20, (120, 160))
    seen = developed(image, [CONDITIONS[name] for name in names], values, (0,))
    box = moved_boxes(np.array([[60.0, 40.0, 80.0, 60.0]]), seen.target, 160, 120)[0]
    rows, columns = np.nonzero(seen.image[..., 0] > 180)
    # pixels are areas, and the last one ends where the next begins
    found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    assert np.abs(box - found).max() <= 2.0


def test_neighbouring_tables_act_in_their_order(image):
    fog, exposure = CONDITIONS["fog"], CONDITIONS["exposure"]
    together = developed(image, [fog, exposure], [(100.0,), (-2.0,)], (0,)).image
    after = under(under(image, fog, 100.0).image, exposure, -2.0).image
    assert_array_equal(together, after)
    grey = under(np.full_like(image, 255), exposure, -1.0).image
    assert abs(int(grey[0, 0, 0]) - 188) <= 1  # half of the light of white is 188 in sRGB


def test_warm_light_is_red_and_cold_light_is_blue(image):
    grey = np.full_like(image, 120)
    red, green, blue = under(grey, CONDITIONS["temperature"], 3_000.0).image[0, 0]
    assert red > green > blue
    red, green, blue = under(grey, CONDITIONS["temperature"], 12_000.0).image[0, 0]
    assert red < green < blue


def test_noise_has_the_deviation_of_the_sensor():
    grey = np.full((200, 200, 3), 188, np.uint8)  # half of white's light: 2,500 electrons at 200
    noisy = under(grey, CONDITIONS["noise"], 200.0).image
    light = ((noisy / 255.0 + 0.055) / 1.055) ** 2.4
    assert light.std() == pytest.approx(np.sqrt(2_500.0 + 9.0) / 5_000.0, rel=0.1)


def test_a_kernel_computes_what_numpy_would(image):
    """What is fast must be rounded right, and noise go on where its numbers end."""
    tall = np.resize(image, (900, 400, 3))
    first, normals = 1_000_000, optics._normals()
    scale = np.linspace(0.5, 90.0, 256).astype(np.float32)
    drawn = np.take(normals, first + np.arange(tall.size), mode="wrap").reshape(tall.shape)
    noisy = np.clip(tall.astype(np.float32) + scale[tall] * drawn, 0, 255) + np.float32(0.5)
    kernels = optics._with_noise(tall, scale, normals, first)
    assert_array_equal(kernels, noisy.astype(np.uint8))
    every, cover = np.mgrid[:256, :256].astype(np.uint8)
    three, colour = np.repeat(every[..., None], 3, axis=2), np.array([0, 70, 255], np.float32)
    kept, paint = (255.0 - cover)[..., None] * three, cover[..., None] * colour
    exact = np.rint(kept / 255.0) + np.rint(paint.astype(float) / 255.0)
    assert_array_equal(optics._painted(three, cover, colour), exact)


def test_conditions_are_chosen_by_set_name_range_and_as_they_are(image):
    assert [each.name for each in find_conditions("weather")] == [
        *("shadow", "rain", "snow", "low_sun", "fog")
    ]
    assert {*SETS["all"]} == {*CONDITIONS}
    assert [each.name for each in find_conditions(["jpeg", "rotation"])] == ["rotation", "jpeg"]
    narrowed = find_conditions({"exposure": (-1.0, 1.0), "jpeg": True})
    assert narrowed[0].parameters[0].low == -1.0
    assert narrowed[1] == CONDITIONS["jpeg"]
    red = Condition("red", (Parameter("red", 0.0, 1.0),), (0.0,), change=lambda i, v, rng: i)
    assert find_conditions([red, "jpeg"])[-1] is red


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("wether", "set of conditions to be one of .*Did you mean weather"),
        (["fogg"], "condition to be one of .*Did you mean fog"),
        ([], "conditions as a name, a list or a table"),
        (["fog", "fog"], "each parameter once, got 'visibility_m'"),
        ([3], "a condition's name or a Condition, got 3"),
        ({"fog": 3}, r"true or \[low, high\] for the condition 'fog'"),
        ({"exposure": (1.0, 2.0)}, "nominal value of 'exposure_ev' within 1 to 2, got 0"),
    ],
)
def test_what_is_no_condition_gets_a_sentence(given, told):
    with pytest.raises(UserError, match=told):
        find_conditions(given)


def test_a_condition_of_ones_own_must_return_an_image(image):
    strength = (Parameter("strength", 0.0, 1.0),)
    with pytest.raises(UserError, match=r"one of table, change and moves .*got 1, 1 and 0 of them"):
        Condition("none", strength, (0.0,))
    cut = Condition("cut", strength, (0.0,), change=lambda i, v, rng: i[1:])
    with pytest.raises(UserError, match=r"Expected uint8 \(120, 160, 3\) from the condition 'cut'"):
        under(image, cut, 1.0)
