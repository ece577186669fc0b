import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sada_gym.envs.uav.camera.pinhole import (
    COLUMNS,
    FORWARD_M,
    ROWS,
    TILT_DEG,
    UP_M,
    DroneCamera,
    camera,
)
from sada_gym.envs.uav.world.gates import BARS, CENTRE_HEIGHT_M, OPENING_WIDTH_M

FINE = DroneCamera(240, 320)
EYE = np.array([FORWARD_M, 0.0, UP_M])


def pose(x=0.0, y=0.0, z=CENTRE_HEIGHT_M, *, yaw=0.0, pitch=0.0, roll=0.0):
    return [x, y, z, *Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_quat()]


def gate(x, y=0.0, heading_deg=0.0):
    return [x, y, CENTRE_HEIGHT_M, np.deg2rad(heading_deg)]


def look(poses, gates, *, looks=None, of=FINE):
    poses = np.atleast_2d(np.array(poses, float))
    gates = np.broadcast_to(np.array(gates, float).reshape(-1, 4), (len(poses), *np.shape(gates)))
    looks = np.arange(len(poses)) if looks is None else looks
    return of.draw(np.ascontiguousarray(gates), poses, looks)


def reddish(picture):
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > green + 60) & (red > blue + 60)


def bluish(picture):
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (blue > 2 * green) & (blue > red + 20)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    gates = rng.uniform([-20, -20, 2, -4], [20, 20, 2, 4], (12, 8, 4))
    turns = Rotation.random(12, random_state=1).as_quat()
    poses = np.hstack([rng.uniform([-20, -20, 0.1], [20, 20, 8], (12, 3)), turns])
    return gates, poses, np.arange(12)


def test_a_picture_has_the_pilots_shape(scene):
    gates, poses, looks = scene
    pictures = camera().draw(gates, poses, looks)
    assert pictures.shape == (12, ROWS, COLUMNS, 3)
    assert pictures.dtype == np.uint8


def test_a_picture_does_not_depend_on_the_others_in_the_batch(scene):
    gates, poses, looks = scene
    together = camera().draw(gates, poses, looks)
    for i in reversed(range(len(poses))):
        alone = camera().draw(gates[i : i + 1], poses[i : i + 1], looks[i : i + 1])
        np.testing.assert_array_equal(alone[0], together[i])


def test_the_order_of_the_gates_does_not_matter(scene):
    gates, poses, looks = scene
    turned = np.ascontiguousarray(gates[:, ::-1])
    np.testing.assert_array_equal(FINE.draw(gates, poses, looks), FINE.draw(turned, poses, looks))


def test_a_gate_stands_where_a_pinhole_sees_it():
    tilt = np.deg2rad(TILT_DEG)
    for x, y, yaw in ((8.0, 1.5, 0.0), (6.0, -2.0, 10.0), (14.0, 3.0, -8.0)):
        rows, columns = np.nonzero(reddish(look(pose(yaw=yaw), [gate(x, y)])[0]))
        turn = Rotation.from_euler("z", -yaw, degrees=True)
        seen, corners = [], []
        for bar_y, bar_z, half_y, half_z in BARS:
            for side in (-1, 1):
                for rise in (-1, 1):
                    corners.append([x - 0.15, y + bar_y + side * half_y, 2 + bar_z + rise * half_z])
                    ahead, left, up = turn.apply(corners[-1] - np.array([0, 0, 2])) - EYE
                    depth = np.cos(tilt) * ahead + np.sin(tilt) * up
                    down = np.sin(tilt) * ahead - np.cos(tilt) * up
                    seen.append([160 - left / depth / FINE.pixel, 120 + down / depth / FINE.pixel])
        low, high = np.min(seen, axis=0), np.max(seen, axis=0)
        assert [columns.min(), rows.min()] == pytest.approx(low, abs=1.5)
        assert [columns.max() + 1, rows.max() + 1] == pytest.approx(high, abs=1.5)
        projected = FINE.project(np.array(pose(yaw=yaw)), np.array(corners))
        np.testing.assert_allclose(projected, seen, atol=1e-6)


def test_what_is_behind_has_no_place():
    assert np.isnan(FINE.project(np.array(pose()), np.array([[-3.0, 0.0, 2.0]]))).all()


def test_the_opening_shows_what_lies_behind():
    bare, framed = look([pose()], [gate(-50.0)])[0], look(pose(), [gate(4.0)])[0]
    row = 120 + int(np.tan(np.deg2rad(TILT_DEG)) / FINE.pixel)
    half = int(OPENING_WIDTH_M / 2 / 4.2 / FINE.pixel)
    np.testing.assert_array_equal(
        framed[row, 160 - half : 160 + half], bare[row, 160 - half : 160 + half]
    )
    assert reddish(framed[row]).any()


def test_front_and_back_have_different_colours():
    front = look(pose(), [gate(6.0)])[0]
    back = look(pose(), [gate(6.0, heading_deg=180)])[0]
    assert reddish(front).sum() > 10 * bluish(front).sum()
    assert bluish(back).sum() > 500


def test_a_near_gate_hides_a_far_one():
    near = look(pose(), [gate(3.0, 1.35)], looks=[1])[0]
    both = look(pose(), [gate(3.0, 1.35), gate(9.0, 4.0)], looks=[1])[0]
    np.testing.assert_array_equal(both[reddish(near)], near[reddish(near)])


def test_passing_through_a_gate_draws_no_nonsense():
    for x in np.arange(-1.0, 1.0, 0.05):
        picture = look(pose(x), [gate(0.0)])[0]
        assert reddish(picture).mean() < 0.75


def test_the_horizon_leans_as_the_drone_does():
    level, leaning = look([pose(pitch=-TILT_DEG), pose(roll=30.0)], [gate(-50.0)], looks=[0, 0])
    green = [p[..., 1].astype(int) > p[..., 2] + 15 for p in (level, leaning)]
    # right side down: the ground reaches higher at the right
    assert green[0][:, :20].sum() == pytest.approx(green[0][:, -20:].sum(), rel=0.1)
    assert green[1][:, -20:].sum() > 1.5 * green[1][:, :20].sum()


def test_looks_change_the_light_and_no_gate():
    pictures = look([pose()] * 6, [gate(6.0)], looks=np.arange(6))
    places = [reddish(p) for p in pictures]
    for i in range(1, 6):
        assert np.abs(pictures[i].astype(int) - pictures[0]).mean() > 3
        assert (places[i] != places[0]).mean() < 0.01


def test_moving_over_the_field_changes_its_picture():
    first, other = look([pose(), pose(0.3)], [gate(-50.0)], looks=[0, 0])
    assert np.abs(first[160:].astype(int) - other[160:]).mean() > 2


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9])
def test_a_lost_drone_sees_black(scene, bad):
    gates, poses, looks = (part.copy() for part in scene)
    poses[3, 1] = bad
    pictures = camera().draw(gates, poses, looks)
    assert not pictures[3].any()
    assert pictures[[2, 4]].any(axis=(1, 2, 3)).all()


def test_below_the_ground_nothing_breaks(scene):
    gates, poses, looks = (part.copy() for part in scene)
    poses[:, 2] = -5.0
    assert camera().draw(gates, poses, looks).any()
