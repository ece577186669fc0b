import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sada_gym.envs.uav.world.drone import (
    GRAVITY_M_S2,
    INERTIA_KG_M2,
    MASS_KG,
    MAX_ROTOR_N,
    SIMULATION_HZ,
    control,
    heading_of,
    upright,
)
from sada_gym.envs.uav.world.gates import CENTRE_HEIGHT_M, OPENING_WIDTH_M
from sada_gym.envs.uav.world.physics import SLOTS, BulletWorld

DT = 1 / SIMULATION_HZ
GATE = np.array([[5.0, 0.0, CENTRE_HEIGHT_M, 0.0]])
NEAR, FAR = [0, -1, -1, -1], [-1, -1, -1, -1]


def headings(states):
    return np.array([heading_of(*state[3:7]) for state in states])


@pytest.fixture
def world():
    world = BulletWorld()
    yield world
    world.close()


class Flight:
    """Drones of one world under command."""

    def __init__(self, world, slots, states):
        self.world, self.slots, self.states = world, slots, np.array(states)
        self.headings = headings(self.states)
        self.rotors = np.full((len(slots), 4), MASS_KG * GRAVITY_M_S2 / 4)
        self.path = [self.states]
        for slot, state in zip(slots, self.states, strict=True):
            world.fill(slot, state)

    def fly(self, commands, seconds):
        wrenches = np.empty((len(self.slots), 6))
        commands = np.broadcast_to(np.array(commands, float), (len(self.slots), 4))
        for _ in range(round(seconds * SIMULATION_HZ)):
            control(self.states, commands, self.headings, self.rotors, wrenches)
            assert (self.rotors >= 0).all()
            assert (self.rotors <= MAX_ROTOR_N).all()
            self.states = self.world.push(self.slots, self.states, wrenches)
            self.path.append(self.states)
        return self.states


def test_free_flight_is_that_of_a_rigid_body(world):
    rng = np.random.default_rng(0)
    state = upright((0, 0, 5), 0.4)
    state[7:] = rng.normal(size=6)
    world.fill(3, state)
    place, attitude = state[:3].copy(), Rotation.from_quat(state[3:7])
    velocity, spin = state[7:10].copy(), state[10:].copy()
    states = state[None]
    for _ in range(120):
        wrench = rng.normal([0, 0, MASS_KG * GRAVITY_M_S2, 0, 0, 0], [1, 1, 1, 0.1, 0.1, 0.1])
        states = world.push([3], states, wrench[None])
        velocity += DT * (wrench[:3] / MASS_KG - [0, 0, GRAVITY_M_S2])
        spin += DT * wrench[3:] / INERTIA_KG_M2
        place += DT * velocity
        attitude = Rotation.from_rotvec(DT * spin) * attitude
    np.testing.assert_allclose(states[0, :3], place, rtol=0, atol=1e-9)
    np.testing.assert_allclose(states[0, 7:10], velocity, rtol=0, atol=1e-9)
    np.testing.assert_allclose(states[0, 10:], spin, rtol=0, atol=1e-7)
    off = (attitude.inv() * Rotation.from_quat(states[0, 3:7])).magnitude()
    assert off < 1e-6


@pytest.mark.parametrize("course", [0.0, 0.7, 2.0, -2.5])
def test_a_velocity_is_reached_in_any_direction_and_the_heading_kept(world, course):
    flight = Flight(world, [0], [upright((0, 0, 5), 0.3)])
    wanted = [8 * np.cos(course), 8 * np.sin(course), 1.0]
    state = flight.fly([*wanted, 0.0], 2.0)[0]
    np.testing.assert_allclose(state[7:10], wanted, atol=0.1)
    swung = np.abs(headings(np.concatenate(flight.path)) - 0.3)
    assert swung.max() < np.deg2rad(10)
    assert swung[-1] < np.deg2rad(0.5)


def test_it_turns_while_it_leans(world):
    flight = Flight(world, [0], [upright((0, 0, 5), 0.0)])
    flight.fly([9.0, 0.0, 0.0, 0.0], 1.5)
    flight.fly([0.0, 9.0, 0.0, 1.5], 1.0)
    assert headings(flight.states)[0] == pytest.approx(1.5, abs=0.12)
    assert abs(flight.states[0, 2] - 5) < 0.5


def test_it_hovers_where_it_is(world):
    flight = Flight(world, [0], [upright((1, 2, 3), -1.0)])
    np.testing.assert_allclose(flight.fly([0, 0, 0, 0], 2.0)[0, :3], [1, 2, 3], atol=0.01)


def test_a_post_stops_a_drone_and_the_opening_does_not(world):
    side = OPENING_WIDTH_M / 2 + 0.1
    starts = [upright((2, 0, 2), 0.0), upright((2, side, 2), 0.0)]
    flight = Flight(world, [4, 9], starts)
    for slot in (4, 9):
        world.surround(slot, GATE, NEAR)
    flight.fly([8, 0, 0, 0], 0.9)
    path = np.array(flight.path)
    assert path[-1, 0, 0] > 6
    assert path[:, 1, 0].max() < 5


def test_frames_of_others_are_air(world):
    starts = [upright((2, 1.3, 2), 0.0)] * 2
    flight = Flight(world, [0, 1], starts)
    world.surround(1, GATE, NEAR)
    flight.fly([8, 0, 0, 0], 0.9)
    assert flight.states[0, 0] > 6
    assert flight.states[1, 0] < 5


def test_frames_come_and_go(world):
    flight = Flight(world, [0], [upright((2, 1.3, 2), 0.0)])
    world.surround(0, GATE, NEAR)
    world.surround(0, GATE, FAR)
    flight.fly([8, 0, 0, 0], 0.9)
    assert flight.states[0, 0] > 6


def test_the_ground_is_solid(world):
    flight = Flight(world, [0], [upright((0, 0, 1), 0.0)])
    flight.fly([0, 0, -5, 0], 2.0)
    assert np.array(flight.path)[:, 0, 2].min() > -0.05


def test_drones_at_the_same_place_do_not_meet():
    world = BulletWorld()
    apart = Flight(world, [0], [upright((0, 0, 3), 0.0)]).fly([6, 2, 0, 1], 1.0)
    world.close()
    world = BulletWorld()
    together = Flight(world, range(SLOTS), [upright((0, 0, 3), 0.0)] * SLOTS)
    np.testing.assert_array_equal(together.fly([6, 2, 0, 1], 1.0), np.repeat(apart, SLOTS, axis=0))
    world.close()


@pytest.mark.parametrize("slot", [0, 7, SLOTS - 1])
def test_a_crash_is_the_same_in_any_slot_beside_any_others(slot):
    start = upright((2, 1.25, 1.8), 0.2)

    def crash(slots, states):
        world = BulletWorld()
        flight = Flight(world, slots, states)
        for other in slots:
            world.surround(other, GATE, NEAR)
        flight.fly([9, 0, -0.5, 0], 2.0)
        world.close()
        return np.array(flight.path)

    alone = crash([5], [start])[:, 0]
    rng = np.random.default_rng(slot)
    others = [upright((2, rng.uniform(-1.5, 1.5), rng.uniform(0.3, 3)), 0) for _ in range(SLOTS)]
    others[slot] = start
    crowd = crash(list(range(SLOTS)), others)
    np.testing.assert_array_equal(crowd[:, slot], alone)
    assert np.abs(np.diff(alone[:, 7])).max() > 1  # it did hit something


def test_a_world_after_another_is_as_the_first():
    def crash():
        world = BulletWorld()
        flight = Flight(world, [2], [upright((2, 1.25, 1.8), 0.2)])
        world.surround(2, GATE, NEAR)
        flight.fly([9, 0, -0.5, 0], 1.5)
        world.close()
        return np.array(flight.path)

    first = crash()
    for _ in range(3):
        np.testing.assert_array_equal(crash(), first)


def test_closing_twice_is_fine_and_pickling_is_not():
    import pickle

    world = BulletWorld()
    with pytest.raises(TypeError, match="no pickling of a PyBullet world"):
        pickle.dumps(world)
    world.close()
    world.close()


def test_it_sinks_while_it_turns_as_fast_as_it_can(world):
    flight = Flight(world, [0], [upright((0, 0, 9), 0.0)])
    for turn in (4.0, -4.0) * 4:
        flight.fly([6.0, 0.0, -3.0, turn], 0.1)
    speed = np.concatenate(flight.path)[SIMULATION_HZ // 2 :, 9]
    assert (speed < -2.0).all()
    assert (np.diff(np.concatenate(flight.path)[:, 2]) <= 1e-3).all()
