"""The renderer: geometry, light and shadow where they should be, equal bytes for equal scenes."""

import dataclasses

import numpy as np
import pytest
import trimesh
from families import family

from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.renderers import default_renderer, tinyrenderer
from sada_gym.envs.detection.renderers.tinyrenderer import VISUALS, TinyRenderer
from sada_gym.envs.detection.scene import Scene, camera_of, centre_of
from sada_gym.envs.detection.shapes import CLASSES, Shape, benchmark_shapes
from sada_gym.envs.detection.shapes.assembly import Part, assemble


def scene(shape, seed=3, **changes):
    base = Scene(
        shape=shape,
        colour=(0.8, 0.2, 0.1),
        camera_distance=9.0,
        camera_azimuth_deg=40.0,
        camera_pitch_deg=20.0,
        light_azimuth_deg=70.0,
        light_pitch_deg=45.0,
        backdrop=random_backdrop(np.random.default_rng(seed)),
    )
    return dataclasses.replace(base, **changes)


def render(*arguments, size=128, **changes):
    return default_renderer().render(scene(*arguments, **changes), size)


CAR = benchmark_shapes("car")[0]


def box_shape(size, materials=0):
    """A cuboid on the ground, unscaled: its silhouette is known."""
    x, y, z = np.array(size) / 2
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    corners = signs * [x, y, z] + [0, 0, z]
    quads = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ]
    vertices, normals, faces = [], [], []
    for quad in quads:
        points = corners[quad]
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        start = len(vertices)
        vertices += points.tolist()
        normals += [(normal / np.linalg.norm(normal)).tolist()] * 4
        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return Shape(
        "test/box",
        "box",
        np.array(vertices, np.float32),
        np.array(normals, np.float32),
        np.array(faces, np.int32),
        np.full(len(faces), materials, np.uint8),
    )


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 90.0, -120.0])
@pytest.mark.parametrize("aim", [(0.0, 0.0), (0.3, -0.2)])
def test_the_box_is_the_projection_of_the_shape(azimuth, aim):
    cuboid = box_shape((3.0, 1.6, 1.2))
    this = scene(cuboid, camera_azimuth_deg=azimuth, aim=aim)
    camera = camera_of(this)
    seen = (cuboid.vertices - camera.eye) @ camera.axes.T
    plane = seen[:, :2] / (-seen[:, 2:] * camera.tangent) - np.array(aim)
    expected = np.concatenate(
        [((plane * [1, -1]).min(0) + 1) * 64, ((plane * [1, -1]).max(0) + 1) * 64]
    )
    found = default_renderer().render(this, 128).box
    np.testing.assert_allclose(found, expected, atol=0.75)


def test_front_side_and_mirror_image():
    """Azimuth 0 sees the front (+x); a positive azimuth moves the camera to the object's left."""
    camera = camera_of(scene(CAR, camera_azimuth_deg=0.0, camera_pitch_deg=0.0))
    np.testing.assert_allclose(camera.eye, np.add(centre_of(scene(CAR)), [9, 0, 0]), atol=1e-9)
    camera = camera_of(scene(CAR, camera_azimuth_deg=90.0, camera_pitch_deg=0.0))
    np.testing.assert_allclose(camera.eye, np.add(centre_of(scene(CAR)), [0, 9, 0]), atol=1e-9)


def test_the_mask_lies_in_the_box_and_the_object_out_of_it_leaves_the_place_alone():
    with_car = render(CAR, light_pitch_deg=89.0)
    x0, y0, x1, y1 = with_car.box
    rows, columns = np.nonzero(with_car.mask)
    assert columns.min() >= np.floor(x0)
    assert columns.max() < np.ceil(x1)
    assert rows.min() >= np.floor(y0)
    assert rows.max() < np.ceil(y1)
    empty = render(None)
    assert empty.box is None
    assert not empty.mask.any()


def test_out_of_sight_is_no_box():
    assert render(CAR, aim=(5.0, 0.0)).box is None


def test_light_shades_the_far_side_and_casts_a_shadow():
    cuboid = box_shape((2.0, 2.0, 2.0))
    flat = {"camera_azimuth_deg": 0.0, "light_pitch_deg": 30.0, "colour": (0.6, 0.6, 0.6)}
    front = render(cuboid, light_azimuth_deg=0.0, **flat)
    back = render(cuboid, light_azimuth_deg=180.0, **flat)
    middle = (slice(60, 72), slice(58, 70))
    assert front.image[middle].mean() > back.image[middle].mean() + 40
    left = render(cuboid, light_azimuth_deg=90.0, **flat).image.astype(int)
    right = render(cuboid, light_azimuth_deg=-90.0, **flat).image.astype(int)
    ground = slice(88, 96)  # beside the cuboid's foot
    assert (left - right)[ground, 4:30].mean() * (left - right)[ground, 98:124].mean() < 0


def test_paint_takes_the_colour_and_other_materials_do_not():
    red, blue = (render(box_shape((2, 2, 2)), colour=c) for c in ((1, 0, 0), (0, 0, 1)))
    channels = (red.image.astype(int) - blue.image)[60:70, 60:70].mean((0, 1))
    assert channels[0] > 60
    assert channels[2] < -60
    rubber = [render(box_shape((2, 2, 2), 1), colour=c) for c in ((1, 0, 0), (0, 0, 1))]
    np.testing.assert_array_equal(rubber[0].image, rubber[1].image)


def test_the_same_scene_gives_the_same_bytes_whatever_was_drawn_before():
    other = TinyRenderer()
    first = render(CAR).image
    for name in ("chair", "boat"):
        other.render(scene(benchmark_shapes(name)[1]), 64)
    np.testing.assert_array_equal(other.render(scene(CAR), 128).image, first)


def test_many_shapes_do_not_pile_up():
    renderer = TinyRenderer()
    before = renderer.render(scene(CAR), 32).image
    bottle = benchmark_shapes("bottle")[0]
    for number in range(VISUALS + 3):
        vertices = bottle.vertices * np.float32(1 - 0.001 * number)
        renderer.render(scene(dataclasses.replace(bottle, vertices=vertices)), 32)
    np.testing.assert_array_equal(renderer.render(scene(CAR), 32).image, before)


def test_a_batch_equals_its_scenes_one_by_one():
    shapes = [CAR, None, benchmark_shapes("boat")[0], benchmark_shapes("car")[1], CAR]
    scenes = [scene(shape, seed) for seed, shape in enumerate(shapes)]
    batch = default_renderer().render_batch(scenes, 64)
    for one, found in zip(scenes, batch, strict=True):
        np.testing.assert_array_equal(default_renderer().render(one, 64).image, found.image)
    assert default_renderer().render_batch([], 64) == []


def test_a_shape_in_pieces_gives_the_same_bytes(monkeypatch):
    """PyBullet takes 123,361 corners at a time: larger shapes become several bodies."""
    most = max(len(shape.faces) for name in CLASSES for shape in benchmark_shapes(name))
    assert 3 * most <= tinyrenderer.CORNERS < 123_362  # the benchmark's are whole
    whole = [render(shape) for shape in benchmark_shapes("bicycle")[:3]]
    monkeypatch.setattr(tinyrenderer, "CORNERS", 3 * 100)
    renderer = TinyRenderer()
    for shape, expected in zip(benchmark_shapes("bicycle"), whole, strict=False):
        assert len(shape.faces) > 200
        found = renderer.render(scene(shape), 128)
        np.testing.assert_array_equal(found.image, expected.image)
        np.testing.assert_array_equal(found.box, expected.box)
    renderer.close()


def test_a_large_shape_is_rendered_and_freed(monkeypatch):
    """82,000 faces raised SystemError; some 42,000 gave other bytes each time, or crashed."""
    monkeypatch.setattr(tinyrenderer, "FACES", 50_000)
    ball = trimesh.creation.icosphere(6)
    assert len(ball.faces) == 81_920
    large = assemble("test/ball", "ball", [Part(ball)])
    renderer = TinyRenderer()
    first = renderer.render(scene(CAR), 64)
    found = renderer.render(scene(large), 64)
    side = 5 / np.sqrt(3) / 2 / (9 * np.tan(np.radians(21))) * 32
    np.testing.assert_allclose(found.box, [32 - side, 32 - side, 32 + side, 32 + side], atol=1.5)
    np.testing.assert_array_equal(renderer.render(scene(CAR), 64).image, first.image)
    np.testing.assert_array_equal(renderer.render(scene(large), 64).image, found.image)
    renderer.close()


@pytest.mark.parametrize("size", [32, 96, 256])
def test_sizes_show_the_same_scene(size):
    small, large = render(CAR, size=size), render(CAR, size=128)
    assert small.image.shape == (size, size, 3)
    np.testing.assert_allclose(small.box / size, large.box / 128, atol=1.5 / size)


def test_places_vary_with_the_seed():
    pictures = [render(CAR, seed).image for seed in range(8)]
    assert len({picture.tobytes() for picture in pictures}) == 8


@pytest.mark.parametrize("name", family(CLASSES, "car"))
def test_every_benchmark_shape_is_in_sight_and_inside_the_frame(name):
    for shape in benchmark_shapes(name):
        found = render(shape, camera_distance=8.0, size=64)
        assert found.mask.sum() > 30, shape.name
        assert (found.box >= 0).all()
        assert (found.box <= 64).all()
