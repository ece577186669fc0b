"""Textured models as data: checked, to plain data and back, told apart by fingerprints."""

import base64
import dataclasses
import json

import numpy as np
import pytest

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes import Material, Shape, Surface, benchmark_shapes, fingerprint
from sada_gym.errors import UserError

RNG = np.random.default_rng(0)
TEXTURE = RNG.integers(0, 256, (5, 7, 4), dtype=np.uint8)
WOOD = Surface("wood", (0.5, 0.25, 1.0), TEXTURE, material=Material.WOOD)
PANE = Surface("pane", opacity=0.3, material=Material.GLASS)
PAINT = Surface("paint", material=Material.PAINT, painted=True)


def textured(surfaces=(WOOD, PANE), materials=(1, 0)):
    """A square of two faces."""
    corners = np.array([[0, -1, 0], [0, 1, 0], [0, 1, 2], [0, -1, 2]])
    return Shape(
        "test/square",
        "bench",
        corners,
        np.array([[1, 0, 0]] * 4),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.array(materials),
        surfaces=surfaces,
        uv=corners[:, 1:],
    )


def test_a_textured_shape_goes_to_plain_data_and_back():
    shape = textured((WOOD, PANE, PAINT))
    assert shape.materials.dtype == np.uint16
    assert shape.uv.dtype == np.float32
    again = Shape.from_dict(shape.to_dict())
    assert again.equals(shape)
    np.testing.assert_array_equal(again.surfaces[0].texture, TEXTURE)
    assert again.surfaces[1].material is Material.GLASS
    scene = dataclasses.replace(DetectionApplication("bench").scene(np.zeros(8), 0), shape=shape)
    read = Scene.from_json(scene.to_json())
    assert read.shape.equals(shape)
    assert fingerprint([read.shape]) == fingerprint([shape])
    assert json.loads(scene.to_json())["shape"]["surfaces"][1]["texture"] is None
    lists = shape.to_dict()
    lists["surfaces"][0]["texture"] = TEXTURE.tolist()
    assert Shape.from_dict(lists).equals(shape)


def test_shapes_without_surfaces_are_written_as_before():
    car = benchmark_shapes("car")[0]
    assert sorted(car.to_dict()) == sorted(
        ("name", "object_class", "vertices", "normals", "faces", "materials", "double_sided")
    )
    assert car.materials.dtype == np.uint8


@pytest.mark.parametrize(
    "change",
    [
        {"colour": (0.5, 0.25, 0.9)},
        {"opacity": 0.9},
        {"material": Material.METAL},
        {"painted": True},
        {"texture": TEXTURE[::-1]},
        {"texture": TEXTURE.reshape(7, 5, 4)},
        {"texture": None},
    ],
)
def test_shapes_that_look_different_have_other_fingerprints(change):
    shape, other = textured(), textured((dataclasses.replace(WOOD, **change), PANE))
    assert not shape.equals(other)
    assert fingerprint([shape]) != fingerprint([other])


def test_another_place_in_the_texture_or_another_surface_counts_too():
    shape = textured()
    for other in (dataclasses.replace(shape, uv=shape.uv + 0.5), textured(materials=(0, 1))):
        assert not shape.equals(other)
        assert fingerprint([shape]) != fingerprint([other])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"materials": [0, 2]}, "materials of test/square to be surfaces 0 to 1, got 0 to 2"),
        ({"materials": [-1, 0]}, "got -1 to 0"),
        ({"materials": [0, 65_536]}, "got 0 to 65536"),
        ({"uv": None}, "Expected uv in test/square, whose surface 'wood' has a texture, got None"),
        ({"uv": np.zeros((3, 2))}, r"Expected uv of shape \(4, 2\) in test/square, got \(3, 2\)"),
        ({"uv": np.full((4, 2), np.nan)}, "Expected uv of test/square within 1,000 of 0, got nan"),
        ({"uv": np.full((4, 2), 1e9)}, "got 1e"),
    ],
)
def test_surfaces_that_do_not_fit_the_mesh_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(textured(), **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"texture": TEXTURE[..., :3]}, r"shape \(h, w, 4\), uint8.*'wood', got \(5, 7, 3\)"),
        ({"texture": TEXTURE / 255}, "got .*float64"),
        ({"texture": np.zeros((1, 1_025, 4), np.uint8)}, "1 to 1,024 pixels a side"),
        ({"texture": np.zeros((0, 4, 4), np.uint8)}, "got .0, 4, 4."),
        ({"colour": (0.5, 0.5)}, "three channels of colour"),
        ({"colour": (0.5, np.nan, 0.5)}, "three channels of colour"),
        ({"opacity": 1.5}, "opacity from 0 to 1 in the surface 'wood'"),
        ({"material": 9}, r"a material among 0 \(PAINT\), .*, got 9"),
    ],
)
def test_surfaces_that_are_none_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(WOOD, **change)


def test_plain_data_that_is_no_surface_is_explained():
    plain = WOOD.to_dict()
    with pytest.raises(UserError, match="Expected a surface with the keys name, colour"):
        Surface.from_dict({"name": "x"})
    for text in ("?", "abcd", base64.b64encode(base64.b64decode(plain["texture"])[:60]).decode()):
        with pytest.raises(UserError, match="'wood' to be a PNG file in base64"):
            Surface.from_dict({**plain, "texture": text})
