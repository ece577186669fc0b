"""A scene is plain data: to JSON and back, the same picture."""

import dataclasses
import json

import numpy as np
import pytest
from families import family

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes import CLASSES, Shape, benchmark_shapes
from sada_gym.envs.detection.shapes.catalogue import find_shape
from studies.training.detection.prior import photograph

MU = np.random.default_rng(0).uniform(-1, 1, (8,)).astype(np.float32)


def same(a, b):
    picture, other = (default_renderer().render(scene, 48).image for scene in (a, b))
    np.testing.assert_array_equal(picture, other)
    assert a.to_json() == b.to_json()


@pytest.mark.parametrize("name", family(CLASSES, "car"))
def test_a_benchmark_scene_goes_to_json_and_back(name):
    scene = DetectionApplication(name).scene(MU, 11)
    plain = scene.to_dict()
    assert plain["shape"] == scene.shape_name
    assert json.loads(json.dumps(plain)) == plain
    same(scene, Scene.from_dict(plain))
    same(scene, Scene.from_json(scene.to_json()))
    assert Scene.from_dict(plain).seed == 11


def test_an_empty_place_and_a_photographers_scene_too():
    rng = np.random.default_rng(0)
    for shape in (None, benchmark_shapes("bus")[3]):
        scene = photograph(shape, rng)
        same(scene, Scene.from_dict(json.loads(scene.to_json())))


def test_a_users_mesh_stays_in_arrays():
    car = benchmark_shapes("car")[0]
    mine = dataclasses.replace(car, name="car/mine.obj", double_sided=True)
    scene = dataclasses.replace(DetectionApplication("car").scene(MU, 3), shape=mine)
    plain = scene.to_dict()
    np.testing.assert_array_equal(plain["shape"]["vertices"], car.vertices)
    again = Scene.from_json(scene.to_json())
    assert again.shape.equals(mine)
    assert again.shape.vertices.dtype == np.float32
    same(scene, Scene.from_dict(plain))
    same(scene, again)
    # another mesh under a benchmark shape's name is not taken for that shape
    changed = dataclasses.replace(car, vertices=car.vertices * np.float32(0.5))
    assert isinstance(dataclasses.replace(scene, shape=changed).to_dict()["shape"], dict)


def test_shapes_are_found_by_their_names():
    for name in CLASSES:
        for shape in benchmark_shapes(name):
            assert find_shape(shape.name) is shape
    for name in (
        "car",
        "car/saloon-1",
        "car/saloon-1000",
        "car/nonsense-0",
        "cat/tabby-0",
        "car/saloon-x",
        "",
    ):
        assert find_shape(name) is None


def test_bad_data_is_explained():
    plain = DetectionApplication("car").scene(MU, 3).to_dict()
    with pytest.raises(ValueError, match=r"Expected a scene with the keys aim, .*, got colour"):
        Scene.from_dict({"colour": [0, 0, 0]})
    with pytest.raises(ValueError, match=r"name of a shape, such as car/saloon-0, got 'car/x-0'"):
        Scene.from_dict({**plain, "shape": "car/x-0"})
    with pytest.raises(ValueError, match=r"Expected a backdrop with the keys"):
        Scene.from_dict({**plain, "backdrop": {}})
    with pytest.raises(ValueError, match=r"Expected a shape with the keys"):
        Shape.from_dict({"name": "x"})
