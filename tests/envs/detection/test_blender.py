"""The real Blender: the rasteriser's scene in other light, equal bytes for equal scenes."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import find_renderer
from sada_gym.envs.detection.renderers.blender import Blender
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.detection.shapes.surface import Material, Surface

pytestmark = pytest.mark.skipif(
    shutil.which(os.environ.get("SADA_GYM_BLENDER") or "blender") is None,
    reason="There is no program `blender` here. Install it: apt-get install blender",
)

SIZE = 48
MU = np.random.default_rng(3).uniform(-1, 1, (3, 8)).astype(np.float32)


@pytest.fixture(scope="module")
def blender():
    renderer = Blender(samples=4)
    yield renderer
    renderer.close()


def scene(object_class="car", seed=1, mu=None, **changes):
    application = DetectionApplication(object_class)
    made = application.scene(np.zeros(8, np.float32) if mu is None else mu, seed)
    return replace(made, **changes)


def grey(picture):
    return picture.astype(float).mean(2)


@pytest.mark.long
def test_equal_scenes_give_equal_bytes_in_any_order_and_process(blender):
    scenes = [scene("car", 1, MU[0]), scene("chair", 2, MU[1]), scene("car", 3, MU[2])]
    first = [picture.image for picture in blender.render_batch(scenes, SIZE)]
    blender.render(scenes[1], 32)
    again = [picture.image for picture in blender.render_batch(scenes[::-1], SIZE)][::-1]
    other = Blender(samples=4)
    elsewhere = [other.render(scenes[i], SIZE).image for i in (1, 2, 0)]
    other.close()
    for i, j in enumerate((2, 0, 1)):
        np.testing.assert_array_equal(first[i], again[i])
        np.testing.assert_array_equal(first[i], elsewhere[j])
    assert not np.array_equal(first[0], first[2])


@pytest.mark.parametrize("aim", [(0.0, 0.0), (0.5, -0.3)])
def test_the_object_stands_where_mask_and_box_say(blender, aim):
    """Where a white and a black object differ, the object is: shadows and mirrors differ less."""
    placed = {"camera_azimuth_deg": 40.0, "camera_pitch_deg": 20.0, "aim": aim}
    white, black = (
        blender.render(scene(colour=(level,) * 3, **placed), 96) for level in (1.0, 0.0)
    )
    differs = grey(white.image) - grey(black.image) > 60
    inside = ndimage.binary_dilation(white.mask, iterations=2)
    assert not (differs & ~inside).any()
    assert differs.sum() > 0.3 * white.mask.sum()
    rows, columns = np.nonzero(differs)
    x0, _, x1, _ = white.box
    found = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    assert x0 - 2 <= found[0] <= x0 + 12
    assert x1 + 2 >= found[2] >= x1 - 12
    flat = find_renderer("rasteriser").render(scene(**placed), 96)
    np.testing.assert_array_equal(white.mask, flat.mask)


@pytest.mark.parametrize("azimuth", [-90.0, 90.0])
def test_shadows_fall_where_the_rasteriser_casts_them(blender, azimuth):
    """The object darkens the ground on the side away from the light."""
    placed = {
        "camera_azimuth_deg": 30.0,
        "camera_pitch_deg": 35.0,
        "light_azimuth_deg": azimuth,
        "light_pitch_deg": 25.0,
    }
    lost = []
    for renderer in (blender, find_renderer("rasteriser")):
        there = renderer.render(scene(**placed), 96)
        nothing = renderer.render(scene(**placed, shape=None, camera_distance=9.0), 96)
        assert nothing.box is None
        level = grey(there.image)
        dark = (level < 0.7 * np.median(level[-20:])) & ~ndimage.binary_dilation(
            there.mask, iterations=2
        )
        dark[:40] = False  # buildings
        lost.append(np.nonzero(dark)[1].mean() - np.nonzero(there.mask)[1].mean())
    assert np.sign(lost[0]) == np.sign(lost[1]) == -np.sign(azimuth)  # 90 lights from the right


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0])
@pytest.mark.parametrize("pitch", [3.0, 30.0, 90.0])
def test_no_light_makes_pictures_black_or_burnt(blender, pitch, azimuth):
    light = {"light_azimuth_deg": azimuth, "light_pitch_deg": pitch, "camera_pitch_deg": 15.0}
    level = grey(blender.render(scene(**light), SIZE).image)
    assert 50 < level.mean() < 200
    assert (level > 250).mean() < 0.35
    assert (level < 5).mean() < 0.1


@pytest.mark.parametrize("index", range(8))
def test_every_parameter_changes_the_picture(blender, index):
    mu = np.full(8, 0.2, np.float32)
    base = blender.render(scene(mu=mu), SIZE).image
    mu[index] = -0.5
    other = blender.render(scene(mu=mu), SIZE).image
    assert np.abs(base.astype(int) - other).max() > 20


def test_the_place_is_drawn(blender):
    """Each part of a backdrop shows: nothing is left out of the scene."""
    base = scene(camera_pitch_deg=8.0)
    before = blender.render(base, SIZE).image.astype(int)
    place = base.backdrop
    for change in (
        {"ground": (place.ground + 1) % 5},
        {"ground_colour": (0.9, 0.1, 0.1)},
        {"buildings": place.buildings[:0]},
        {"zenith": (0.4, 0.4, 0.4)},
        {"gloss": 0.9 - place.gloss},
    ):
        other = replace(base, backdrop=replace(place, **change))
        assert np.abs(before - blender.render(other, SIZE).image).max() > 15, change


def board(*surfaces):
    """An upright board that looks along +x; u runs to the right as seen from there, v up."""
    corners = [(0, -2, 0.0), (0, 2, 0.0), (0, 2, 3.0), (0, -2, 3.0)]
    return Shape(
        "car/board",
        "car",
        np.array(corners, np.float32),
        np.tile(np.array([1, 0, 0], np.float32), (4, 1)),
        np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        np.array([0, len(surfaces) - 1], np.uint16),
        double_sided=True,
        surfaces=surfaces,
        uv=np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
    )


def seen(blender, *surfaces, **changes):
    placed = {
        "shape": board(*surfaces),
        "camera_azimuth_deg": 0.0,
        "camera_pitch_deg": 5.0,
        "light_azimuth_deg": 30.0,
        "light_pitch_deg": 30.0,
        "camera_distance": 8.0,
    }
    return blender.render(scene(**placed | changes), 64)


def quarters():
    """Red, green / blue, hole, from the upper left."""
    texture = np.full((8, 8, 4), 255, np.uint8)
    texture[:4, :4, :3], texture[:4, 4:, :3] = (255, 0, 0), (0, 255, 0)
    texture[4:, :4, :3], texture[4:, 4:, 3] = (0, 0, 255), 0
    return texture


@pytest.mark.slow
def test_textures_lie_as_the_model_says(blender):
    surface = Surface("all", texture=quarters())
    there = seen(blender, surface)
    rows, columns = np.nonzero(there.mask)
    x, y = columns.min() + 10, rows.min() + 6
    corner = {
        (0, 0): there.image[y, x],
        (0, 1): there.image[y, columns.max() - 10],
        (1, 0): there.image[rows.max() - 6, x],
    }
    assert [int(np.argmax(pixel)) for pixel in corner.values()] == [0, 1, 2]


@pytest.mark.long
def test_glass_lets_light_through_and_paint_takes_the_scenes_colour(blender):
    middle = (slice(28, 36), slice(28, 36))
    solid = seen(blender, Surface("solid", colour=(0.9, 0.1, 0.1))).image[middle]
    clear = seen(blender, Surface("clear", colour=(0.9, 0.1, 0.1), opacity=0.1)).image[middle]
    assert solid[..., 0].mean() - solid[..., 1].mean() > 60
    empty = seen(blender, Surface(), shape=None).image[middle]
    means = [part.mean((0, 1)) for part in (solid, clear, empty)]
    assert np.abs(means[1] - means[2]).max() < 0.5 * np.abs(means[0] - means[2]).max()
    painted = Surface("painted", colour=(0.9, 0.1, 0.1), painted=True, material=Material.PAINT)
    for colour, strongest in (((0.1, 0.1, 0.9), 2), ((0.1, 0.9, 0.1), 1)):
        pixel = seen(blender, painted, colour=colour).image[middle].mean((0, 1))
        assert int(pixel.argmax()) == strongest


@pytest.mark.parametrize("shift", [-0.6, 0.0, 0.9])
@pytest.mark.parametrize("pitch", [0.0, 50.0])
def test_the_pole_stands_where_the_rasteriser_draws_it(blender, shift, pitch):
    placed = {"camera_pitch_deg": pitch, "aim": (0.2, -0.1), "colour": (0.9, 0.2, 0.1)}
    covered = []
    for renderer in (blender, find_renderer("rasteriser")):
        plain, hidden = (
            renderer.render(scene(**placed, occluder=occluder), 80) for occluder in (None, shift)
        )
        np.testing.assert_array_equal(plain.mask, hidden.mask)
        np.testing.assert_array_equal(plain.box, hidden.box)
        covered.append(np.abs(plain.image.astype(int) - hidden.image).max(2) > 10)
    middle, half = 40 * (1 + shift), 40 * 0.15
    columns = np.arange(80) + 0.5
    beside = np.abs(columns - middle) > half + 2
    for changed in covered:
        # what lies far beside the pole stays as it is, but for noise
        assert changed[:, beside].mean() < 0.1
        assert changed[:, np.abs(columns - middle) < half - 1].mean() > 0.5


KILLED = """
import os, signal
import numpy as np
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers.blender import Blender
application = DetectionApplication("car", renderer=Blender(samples=1), image_size=32)
application.observation(np.zeros(8), 1)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.long
def test_a_killed_run_leaves_no_folder_behind(tmp_path):
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", KILLED], env=environment, check=False)
    assert done.returncode == -9
    assert list(tmp_path.iterdir()) == []
