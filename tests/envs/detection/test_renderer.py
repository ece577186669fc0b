"""The renderer: geometry, light and shadow where they should be, equal bytes for equal scenes."""

import dataclasses

import numpy as np
import pytest
import trimesh
from families import family

from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.renderers.rasteriser import Rasteriser
from sada_gym.envs.detection.scene import Scene, camera_of, centre_of
from sada_gym.envs.detection.shapes import CLASSES, Shape, benchmark_shapes
from sada_gym.envs.detection.shapes.assembly import Part, assemble
from sada_gym.errors import UserError


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
    box = default_renderer().render(this, 128).box
    np.testing.assert_allclose(box, expected, atol=0.75)


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
    other = Rasteriser()
    first = render(CAR).image
    for name in ("chair", "boat"):
        other.render(scene(benchmark_shapes(name)[1]), 64)
    np.testing.assert_array_equal(other.render(scene(CAR), 128).image, first)


def test_a_batch_equals_its_scenes_one_by_one():
    shapes = [CAR, None, benchmark_shapes("boat")[0], benchmark_shapes("car")[1], CAR]
    scenes = [scene(shape, seed) for seed, shape in enumerate(shapes)]
    batch = default_renderer().render_batch(scenes, 64)
    for world, rendering in zip(scenes, batch, strict=True):
        np.testing.assert_array_equal(default_renderer().render(world, 64).image, rendering.image)
    assert default_renderer().render_batch([], 64) == []


def test_a_large_shape_is_drawn_where_it_is():
    ball = trimesh.creation.icosphere(6)
    assert len(ball.faces) == 81_920
    rendering = render(assemble("test/ball", "ball", [Part(ball)]), size=64)
    side = 5 / np.sqrt(3) / 2 / (9 * np.tan(np.radians(21))) * 32
    np.testing.assert_allclose(
        rendering.box, [32 - side, 32 - side, 32 + side, 32 + side], atol=1.5
    )
    np.testing.assert_allclose(rendering.mask.sum(), np.pi * side**2, rtol=0.05)


def test_triangles_without_area_or_numbers_are_left_out():
    cuboid = box_shape((2.0, 2.0, 2.0))
    flawed = dataclasses.replace(
        cuboid,
        vertices=np.vstack(
            [cuboid.vertices, [[np.nan, 0, 0], [np.inf, 1, 1], [1e30, -1e30, 1e30]]]
        ),
        normals=np.vstack([cuboid.normals, np.zeros((3, 3))]),
        faces=np.vstack(
            [cuboid.faces, [[0, 0, 0], [0, 1, 1], [0, 1, 24], [25, 2, 3], [25, 24, 26]]]
        ),
        materials=np.append(cuboid.materials, [0, 0, 0, 0, 0]),
    )
    flawed.__dict__.update(height=cuboid.height)  # of NaN there is none
    for rendering, expected in (
        (render(flawed, camera_pitch_deg=p), render(cuboid, camera_pitch_deg=p))
        for p in (0.0, 50.0)
    ):
        np.testing.assert_array_equal(rendering.image, expected.image)


def test_no_faces_are_an_empty_place():
    cuboid = box_shape((2.0, 2.0, 2.0))
    empty = dataclasses.replace(cuboid, faces=cuboid.faces[:0], materials=cuboid.materials[:0])
    rendering = render(empty)
    assert rendering.box is None
    assert not rendering.mask.any()
    assert rendering.image.std() > 0


def test_what_is_behind_the_camera_is_not_seen():
    """The camera stands in the middle of a row of boxes and looks along it."""
    cuboid = box_shape((1.0, 1.0, 1.0))

    def at(*places):
        return Shape(
            "test/row",
            "box",
            np.vstack([np.add(cuboid.vertices, [x, 0, 0]) for x in places]),
            np.vstack([cuboid.normals] * len(places)),
            np.vstack([cuboid.faces + 24 * k for k in range(len(places))]),
            np.zeros(12 * len(places), np.uint8),
        )

    level = {"camera_azimuth_deg": 0.0, "camera_pitch_deg": 0.0, "light_pitch_deg": 89.0}
    ahead, both = (render(at(*places), **level) for places in ((0,), (0, 14, 300)))
    np.testing.assert_array_equal(both.mask, ahead.mask)
    assert ahead.mask.sum() > 100
    assert render(at(14), **level).box is None


def test_a_face_that_reaches_behind_the_camera_is_cut_off_at_it():
    """A floor below the camera fills the picture's lower half, whatever lies behind the eye."""
    floor = Shape(
        "test/floor",
        "floor",
        np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]]),
        np.array([[0, 0, 1]] * 4),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.zeros(2),
        double_sided=True,
    )
    floor.__dict__.update(height=2.0)  # the camera's height is half of it
    rendering = render(floor, camera_pitch_deg=0.0, camera_azimuth_deg=0.0)
    assert rendering.mask[70:].all()
    assert not rendering.mask[:62].any()


def test_open_surfaces_show_from_behind_only_if_they_are_double_sided():
    sheet = Shape(
        "test/sheet",
        "sheet",
        np.array([[0, -1, 0], [0, 1, 0], [0, 1, 2], [0, -1, 2]]),
        np.array([[1, 0, 0]] * 4),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.zeros(2),
    )
    both = dataclasses.replace(sheet, double_sided=True)
    light = {"light_azimuth_deg": 0.0, "light_pitch_deg": 20.0, "camera_pitch_deg": 0.0}
    fronts = [render(shape, camera_azimuth_deg=0.0, **light) for shape in (sheet, both)]
    np.testing.assert_array_equal(fronts[0].image, fronts[1].image)
    assert render(sheet, camera_azimuth_deg=180.0, **light).box is None
    behind = render(both, camera_azimuth_deg=180.0, **light)
    np.testing.assert_array_equal(behind.mask, fronts[1].mask)
    middle = (slice(56, 72), slice(56, 72))  # lit from the camera's side both times
    levels = [picture.image[middle].astype(int) for picture in (behind, fronts[1])]
    assert abs(levels[0].mean() - levels[1].mean()) < 12


@pytest.mark.parametrize("size", [8, 33, 101, 130])
def test_pictures_of_any_size(size):
    rendering = render(CAR, size=size)
    assert rendering.image.shape == (size, size, 3)
    np.testing.assert_allclose(rendering.box / size, render(CAR).box / 128, atol=1.5 / size)


def test_meshes_that_are_none_are_refused():
    cuboid = box_shape((1.0, 1.0, 1.0))
    for wrong, message in (
        ({"faces": cuboid.faces + 20}, "name vertices 0 to 23, got 20 to 43"),
        ({"faces": cuboid.faces - 1}, "got -1 to 22"),
        ({"normals": cuboid.normals[:5]}, r"normals of shape \(24, 3\) in test/box, got \(5, 3\)"),
        ({"materials": cuboid.materials[:5]}, r"materials of shape \(12,\)"),
        ({"vertices": cuboid.vertices.ravel()}, r"vertices of shape \(72, 3\)"),
    ):
        with pytest.raises(UserError, match=message):
            dataclasses.replace(cuboid, **wrong)


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
        rendering = render(shape, camera_distance=8.0, size=64)
        assert rendering.mask.sum() > 30, shape.name
        assert (rendering.box >= 0).all()
        assert (rendering.box <= 64).all()
