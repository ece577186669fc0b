"""Textured models in pictures: textures in their places, filtered; holes, glass and paint."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from test_renderer import box_shape, scene

from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.renderers.skin import LINEAR, _pyramid, skin_of
from sada_gym.envs.detection.scene import camera_of
from sada_gym.envs.detection.shapes import Material, Shape, Surface

RED, GREEN, BLUE, WHITE = (255, 0, 0, 255), (0, 255, 0, 255), (0, 0, 255, 255), (255,) * 4
CLEAR = (255, 255, 255, 0)


def texture(rows):
    return np.array(rows, np.uint8)


def board(surface, uv=None, *, y=(-1, 1), x=0.0, more=()):
    """A square that looks along +x, its texture's lower left corner at y = -1, z = 0."""
    corners = np.array([[x, y[0], 0], [x, y[1], 0], [x, y[1], 2], [x, y[0], 2]], float)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    parts = [(corners, unit if uv is None else np.asarray(uv, float), surface), *more]
    return Shape(
        "test/board",
        "board",
        np.vstack([part[0] for part in parts]),
        np.tile([[1.0, 0, 0]], (4 * len(parts), 1)),
        np.vstack([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(len(parts))]),
        np.repeat(np.arange(len(parts)), 2),
        double_sided=True,
        surfaces=tuple(part[2] for part in parts),
        uv=np.vstack([part[1] for part in parts]),
    )


def render(shape, size=128, **changes):
    view = {"camera_azimuth_deg": 0.0, "camera_pitch_deg": 0.0, "light_azimuth_deg": 0.0}
    return default_renderer().render(scene(shape, **(view | changes)), size)


def hue(picture):
    """The channel that is brightest on average."""
    return int(picture.reshape(-1, 3).mean(axis=0).argmax())


def middle(rendering, margin=0.1):
    """The picture of the object without a share of its width on all sides."""
    x0, y0, x1, y1 = rendering.box.round().astype(int)
    rim = int(np.ceil(margin * (x1 - x0)))
    return rendering.image[y0 + rim : y1 - rim, x0 + rim : x1 - rim].astype(float)


def quarters(rendering):
    """The hues in the upper left, upper right, lower left, lower right of the object."""
    inside = middle(rendering, 0.06)
    height, width = np.array(inside.shape[:2]) * 2 // 5
    return [
        hue(inside[rows, columns])
        for rows in (slice(height), slice(-height, None))
        for columns in (slice(width), slice(-width, None))
    ]


FOUR = Surface("four", texture=texture([[RED, GREEN], [BLUE, RED]]).repeat(16, 0).repeat(16, 1))


@pytest.mark.parametrize("size", [32, 128, 320, 512])
def test_a_texture_stands_upright(size):
    rendering = render(board(FOUR), size)
    assert rendering.image.shape == (size, size, 3)
    assert quarters(rendering) == [0, 1, 2, 0]


def test_a_texture_repeats_beyond_its_edges():
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    upright = render(board(FOUR))
    for shift in ((1, 0), (-3, 7), (0, -1)):
        moved = render(board(FOUR, unit + shift))
        assert np.abs(moved.image.astype(int) - upright.image).max() <= 1
    assert quarters(render(board(FOUR, unit + np.array([0.5, 0])))) == [1, 0, 0, 2]
    mirrored = unit * [-1, 1]
    assert quarters(render(board(FOUR, mirrored))) == [1, 0, 0, 2]


def test_a_texture_follows_the_perspective():
    """The seam in the texture's middle is where the middle of the floor is."""
    halves = Surface("halves", texture=texture([[RED], [BLUE]]).repeat(64, 0).repeat(8, 1))
    shape = board(halves)
    floor = dataclasses.replace(
        shape,
        vertices=np.array([[5, -2, 0], [5, 2, 0], [-30, 2, 0], [-30, -2, 0]]),
        normals=np.tile([[0, 0, 1]], (4, 1)),
    )
    floor.__dict__.update(height=2.0)
    this = scene(floor, camera_azimuth_deg=0.0, camera_pitch_deg=15.0)
    image = default_renderer().render(this, 256).image[:, 128].astype(int)
    camera = camera_of(this)
    x, _, z = camera.axes @ (np.array([-12.5, 0, 0]) - camera.eye)
    y = (camera.axes @ (np.array([-12.5, 0, 0]) - camera.eye))[1]
    seam = 128 * (1 - y / (-z * camera.tangent))
    assert abs(x) < 1e-9
    redder = image[:, 0] > image[:, 2]
    assert redder[int(seam) - 6 : int(seam) - 2].all()
    assert not redder[int(seam) + 3 : int(seam) + 20].any()


def checked(cells, dark=(0, 0, 0, 255)):
    """A board of black and white cells, 4 texels each."""
    pattern = np.indices((cells, cells)).sum(axis=0) % 2
    pixels = np.where(pattern[..., None] == 0, WHITE, dark).astype(np.uint8)
    return Surface("checked", texture=pixels.repeat(4, 0).repeat(4, 1))


GREY = round(255 * float(np.searchsorted(LINEAR, 0.5)) / 255)


@pytest.mark.parametrize("distance", [9.0, 14.5])
def test_a_far_checkerboard_is_grey_and_does_not_shimmer(distance):
    """128 cells on some 40 pixels: their mean, as light, whatever the camera's exact place."""
    grey = Surface("grey", texture=np.full((4, 4, 4), (GREY, GREY, GREY, 255), np.uint8))
    view = {"camera_distance": distance, "size": 64}
    expected = middle(render(board(grey), **view)).mean()
    views = [
        middle(render(board(checked(128)), camera_azimuth_deg=azimuth, **view))
        for azimuth in (0.0, 0.21, 0.43)
    ]
    for picture in views:
        assert abs(picture.mean() - expected) < 4
        assert picture.std() < 8


def test_a_texture_seen_at_a_flat_angle_stays_sharp():
    """Stripes along the line of sight are told apart where stripes across it have become grey."""
    stripes = np.tile(texture([[WHITE, (0, 0, 0, 255)]]).repeat(8, 1), (128, 8, 1))
    along = Surface("along", texture=np.ascontiguousarray(stripes))
    across = Surface("across", texture=np.ascontiguousarray(stripes.swapaxes(0, 1)))
    contrast = [
        np.abs(np.diff(middle(render(board(surface), camera_azimuth_deg=75.0)), axis=axis)).mean()
        for axis, surface in enumerate((across, along))
    ]
    # the board is ten pixels wide: stripes side by side blend, stripes above each other stay
    assert contrast[0] > 3 * contrast[1]


def test_holes_are_not_the_object_and_let_light_through():
    half = Surface("half", texture=texture([[WHITE, CLEAR]]).repeat(32, 0).repeat(16, 1))
    whole = render(board(Surface("whole", texture=texture([[WHITE]]))))
    holed = render(board(half))
    x0, y0, x1, y1 = whole.box
    np.testing.assert_allclose(holed.box, [x0, y0, (x0 + x1) / 2, y1], atol=1.5)
    assert abs(holed.mask.sum() / whole.mask.sum() - 0.5) < 0.05
    empty = render(None)
    right = np.s_[int(y0) + 4 : int(y1) - 4, int((x0 + x1) / 2) + 4 : int(x1) - 4]
    above = np.s_[: int(y0) - 4, int(x0) : int(x1)]
    for seen in (above, right):
        assert np.abs(holed.image[seen].astype(int) - empty.image[seen]).mean() < 25


@pytest.mark.parametrize("distance", [8.0, 14.5])
def test_a_far_fence_hides_as_much_as_it_is_solid(distance):
    """A fence too fine for the picture: half of the samples show it."""
    fence = board(checked(64, dark=(0, 0, 0, 0)))
    solid = board(checked(64, dark=(255, 255, 255, 255)))
    views = [render(shape, 32, camera_distance=distance, seed=5) for shape in (fence, solid)]
    seen = [middle(view, 0.2).mean() for view in views]
    ground = render(None, 32, camera_distance=distance, seed=5).image.astype(float)
    x0, y0, x1, y1 = views[1].box.round().astype(int)
    behind = ground[y0 + 2 : y1 - 2, x0 + 2 : x1 - 2].mean()
    share = (seen[0] - behind) / (seen[1] - behind)
    assert 0.25 < share < 0.75


def before(pane, x=1.0):
    """A red board, and a pane before it (or behind)."""
    red = Surface("red", (1.0, 0.0, 0.0))
    corners = np.array([[x, -1, 0], [x, 1, 0], [x, 1, 2], [x, -1, 2]])
    unit = np.zeros((4, 2))
    return board(red, more=[(corners, unit, pane)])


def test_glass_shows_what_is_behind_it():
    blue = (0.0, 0.0, 1.0)
    views = {
        opacity: render(before(Surface("pane", blue, opacity=opacity, material=Material.GLASS)))
        for opacity in (0.0, 0.2, 0.6, 1.0)
    }
    colours = np.array([middle(view, 0.3).mean(axis=(0, 1)) for view in views.values()])
    assert (np.diff(colours[:, 0]) < -5).all()  # less and less red
    assert colours[0, 0] > colours[0, 2] + 50
    assert colours[3, 2] > colours[3, 0] + 50
    np.testing.assert_array_equal(views[0.2].mask, views[1.0].mask)  # glass is of the object
    alone = board(Surface("red", (1.0, 0.0, 0.0)))
    np.testing.assert_array_equal(views[0.0].image, render(alone).image)


def test_glass_behind_a_solid_board_is_not_seen():
    pane = Surface("pane", (0.0, 0.0, 1.0), opacity=0.3)
    alone = render(board(Surface("red", (1.0, 0.0, 0.0))), light_pitch_deg=80.0)
    with_pane = render(before(pane, x=-0.5), light_pitch_deg=80.0)
    np.testing.assert_array_equal(middle(with_pane, 0.25), middle(alone, 0.25))


def test_glass_alone_lets_the_place_through():
    """With nothing behind it, a pane dims the place instead of hiding it."""
    pane = Surface("pane", (0.0, 0.0, 0.0), opacity=0.3, material=Material.GLASS)
    seen, empty = (render(s, light_pitch_deg=80.0) for s in (board(pane), None))
    x0, y0, x1, y1 = seen.box.round().astype(int)
    inside = np.s_[y0 + 3 : y1 - 3, x0 + 3 : x1 - 3]
    place, through = (view.image[inside].astype(float) for view in (empty, seen))
    assert np.corrcoef(place.ravel(), through.ravel())[0, 1] > 0.9


def test_only_painted_surfaces_take_the_scenes_colour():
    painted = Surface("body", material=Material.PAINT, painted=True, texture=texture([[WHITE]]))
    other = dataclasses.replace(painted, painted=False)
    red, blue = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    hues = [hue(middle(render(board(painted), colour=colour))) for colour in (red, blue)]
    assert hues == [0, 2]
    views = [render(board(other), colour=colour).image for colour in (red, blue)]
    np.testing.assert_array_equal(*views)


def test_a_painted_surface_looks_like_paint():
    plain = box_shape((2.0, 2.0, 2.0))
    surface = Surface("body", material=Material.PAINT, painted=True)
    skinned = dataclasses.replace(plain, surfaces=(surface,))
    views = [render(shape, camera_azimuth_deg=30.0) for shape in (plain, skinned)]
    np.testing.assert_array_equal(views[0].mask, views[1].mask)
    # shadows are sharper
    np.testing.assert_allclose(middle(views[1], 0.3), middle(views[0], 0.3), atol=4)


def test_uv_without_extent_and_textures_of_one_texel_are_drawn():
    red = Surface("red", texture=texture([[RED]]))
    for uv in (np.zeros((4, 2)), np.full((4, 2), 1_000.0), [[0, 0], [900, 0], [0, 0], [0, -900]]):
        assert hue(middle(render(board(red, uv)))) == 0


@pytest.mark.parametrize("size", [(7, 5), (1, 9), (64, 3), (33, 32)])
def test_all_levels_of_a_texture_have_its_mean(size):
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (*size, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    levels = _pyramid(pixels)
    assert levels[-1].shape == (1, 1, 4)
    mean = LINEAR[pixels[..., :3]].mean(axis=(0, 1))
    for level in levels:
        np.testing.assert_allclose(LINEAR[level[..., :3]].mean(axis=(0, 1)), mean, atol=0.02)


def test_what_is_prepared_for_a_shape_goes_with_it():
    shape = board(FOUR)
    skin = skin_of(shape)
    assert skin_of(shape) is skin
    texels = weakref.ref(skin.texels)
    del skin, shape
    gc.collect()
    assert texels() is None
