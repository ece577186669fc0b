"""What a drone touches, against boxes whose distance a least-squares solver gives."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from sada_gym.envs.uav.world.drone import upright
from sada_gym.envs.uav.world.gates import BARS, CENTRE_HEIGHT_M, DEPTH_M, OPENING_WIDTH_M
from sada_gym.envs.uav.world.referee import BODY_M, touches

LENGTH, WIDTH, HEIGHT = BODY_M
H = CENTRE_HEIGHT_M
GATE = np.array([3.0, -2.0, H, 0.7])
HAIR = 1e-9


def drone(place, *, heading=0.0, turn=None):
    state = upright(place, heading)
    if turn is not None:
        state[3:7] = turn.as_quat()
    return state


def in_gate(ahead, left, up, **options):
    """A drone at a place in the frame of a gate at the origin."""
    return drone((ahead, left, H + up), **options)


def hits(state, gates=((0.0, 0.0, H, 0.0),)):
    return bool(touches(state, np.array(gates, float)))


def apart(state, gate):
    """The distance of the drone's box from the nearest bar of a gate."""
    own = Rotation.from_quat(state[3:7]).as_matrix()
    frame = Rotation.from_euler("z", gate[3]).as_matrix()
    distances = []
    for y, z, width, height in BARS:
        offset = gate[:3] + frame @ [0, y, z] - state[:3]
        most = np.array([*np.array(BODY_M) / 2, DEPTH_M / 2, width, height])
        solved = lsq_linear(np.hstack([own, -frame]), offset, (-most, most), tol=1e-14)
        distances.append(np.sqrt(2 * solved.cost))
    return min(distances)


@pytest.mark.parametrize("tumbling", [True, False])
def test_any_place_and_attitude_agrees_with_the_distance(tumbling):
    rng = np.random.default_rng(int(tumbling))
    frame = Rotation.from_euler("z", GATE[3])
    contacts = []
    for _ in range(400):
        turn = Rotation.from_quat(rng.normal(size=4))
        if not tumbling:  # parallel to the bars
            turn = frame * Rotation.from_euler("z", rng.integers(4) * np.pi / 2)
        place = GATE[:3] + frame.apply(rng.uniform([-0.5, -1.8, -1.6], [0.5, 1.8, 1.8]))
        state = drone(place, turn=turn)
        contacts.append(hits(state, GATE[None]))
        assert contacts[-1] == (apart(state, GATE) < 1e-7)
    assert 50 < sum(contacts) < 350


@pytest.mark.parametrize(("axis", "side"), [(1, 1), (1, -1), (2, 1), (2, -1)])
def test_each_bar_is_touched_from_inside_the_opening(axis, side):
    edge = OPENING_WIDTH_M / 2 - BODY_M[axis] / 2
    place = np.zeros(3)
    place[axis] = side * (edge - HAIR)
    assert not hits(in_gate(*place))
    place[axis] = side * (edge + HAIR)
    assert hits(in_gate(*place))


@pytest.mark.parametrize("side", [1, -1])
def test_a_bar_is_touched_from_the_front_and_from_behind(side):
    edge = (DEPTH_M + LENGTH) / 2
    assert not hits(in_gate(side * (edge + HAIR), 1.3, 0.0))
    assert hits(in_gate(side * (edge - HAIR), 1.3, 0.0))


def test_posts_reach_the_ground_and_nothing_lies_between_them_below():
    assert hits(in_gate(0, 1.3, -H + 0.2))
    assert not hits(in_gate(0, 0.0, -H + 0.2))


def test_the_middle_is_free_in_any_attitude():
    for turn in Rotation.random(50, random_state=0):
        assert not hits(in_gate(0, 0, 0, turn=turn))


def test_a_drone_on_edge_is_as_wide_as_it_is_high():
    on_edge = Rotation.from_euler("x", np.pi / 2)
    left = OPENING_WIDTH_M / 2 - WIDTH / 2 + 0.01
    assert hits(in_gate(0, left, 0))
    assert not hits(in_gate(0, left, 0, turn=on_edge))


def test_a_corner_touches_before_a_side():
    left = OPENING_WIDTH_M / 2 - WIDTH / 2 - 0.005
    assert not hits(in_gate(0, left, 0))
    assert hits(in_gate(0, left, 0, heading=np.pi / 6))


@pytest.mark.parametrize("turn", ["upright", "upside down"])
def test_the_ground_is_touched_by_belly_and_by_back(turn):
    turned = Rotation.from_euler("x", 0.0 if turn == "upright" else np.pi)
    assert not hits(drone((30, 0, HEIGHT / 2 + HAIR), turn=turned))
    assert hits(drone((30, 0, HEIGHT / 2 - HAIR), turn=turned))
    assert hits(drone((30, 0, HEIGHT / 2 + 0.02), turn=Rotation.from_euler("y", 0.5)))


def test_every_gate_counts_and_far_ones_do_not():
    gates = np.array([[10.0 * k, 0, H, 0.3 * k] for k in range(8)])
    for x, y, _, heading in gates:
        post = (x - 1.35 * np.sin(heading), y + 1.35 * np.cos(heading), H)
        assert hits(drone(post), gates)
        assert not hits(drone((x, y + 5, H)), gates)
