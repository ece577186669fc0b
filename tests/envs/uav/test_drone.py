import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sada_gym.envs.uav.world.drone import (
    GRAVITY_M_S2,
    MASS_KG,
    MAX_ROTOR_N,
    SIMULATION_HZ,
    control,
    heading_of,
    upright,
)
from sada_gym.envs.uav.world.physics import FreeBodies, free_bodies

DT = 1 / SIMULATION_HZ


def headings(states):
    return np.array([heading_of(*state[3:7]) for state in states])


class Flight:
    """Drones under command."""

    def __init__(self, states):
        self.bodies, self.states = FreeBodies(), np.array(states)
        self.headings = headings(self.states)
        self.rotors = np.full((len(states), 4), MASS_KG * GRAVITY_M_S2 / 4)
        self.path = [self.states.copy()]

    def fly(self, commands, seconds):
        which = np.arange(len(self.states))
        commands = np.tile(np.array(commands, float), (len(which), 1))
        self.bodies.place(self.states[:, :7])
        for _ in range(round(seconds * SIMULATION_HZ)):
            control(which, self.states, commands, self.headings, self.rotors)
            assert (self.rotors >= 0).all()
            assert (self.rotors <= MAX_ROTOR_N).all()
            self.states[:, :7] = self.bodies.step(self.states[:, 7:])
            self.path.append(self.states.copy())
        return self.states


def glide(bodies, poses, velocities):
    """Return the poses after each of some steps, (steps, n, 7)."""
    bodies.place(poses)
    return np.array([bodies.step(now) for now in velocities])


def test_a_body_moves_as_its_velocities_say():
    velocities = np.random.default_rng(0).normal(0, 5, (500, 1, 6))
    start = upright((0, 0, 5), 0.4)[None, :7]
    place, attitude = start[0, :3].copy(), Rotation.from_quat(start[0, 3:])
    for now in velocities[:, 0]:
        place += DT * now[:3]
        attitude = Rotation.from_rotvec(DT * now[3:]) * attitude
    pose = glide(FreeBodies(), start, velocities)[-1, 0]
    np.testing.assert_allclose(pose[:3], place, rtol=0, atol=1e-12)
    assert (attitude.inv() * Rotation.from_quat(pose[3:])).magnitude() < 1e-12


def test_a_body_at_rest_does_not_fall_asleep():
    bodies = FreeBodies()
    velocities = np.zeros((20 * SIMULATION_HZ, 1, 6))
    velocities[-1, 0, 0] = 2.4
    poses = glide(bodies, upright((0, 0, 5), 0.0)[None, :7], velocities)
    np.testing.assert_allclose(poses[-2:, 0, 0], [0.0, 0.01], atol=1e-15)


@pytest.mark.parametrize(("count", "place"), [(2, 0), (16, 7), (64, 63), (130, 99)])
def test_bodies_do_not_depend_on_one_another(count, place):
    rng = np.random.default_rng(count)
    poses = np.tile(upright((0, 0, 3), 0.5)[:7], (count, 1))
    poses[:, :3] += rng.normal(0, 0.01, (count, 3))  # all at nearly one place: they never meet
    velocities = rng.normal(0, 5, (100, count, 6))
    crowd = FreeBodies()
    crowd.place(np.tile(poses, (2, 1)))  # some bodies leave, others stay
    alone = glide(FreeBodies(), poses[[place]], velocities[:, [place]])
    np.testing.assert_array_equal(glide(crowd, poses, velocities)[:, place], alone[:, 0])


def test_every_thread_has_bodies_of_its_own():
    bodies = []
    other = threading.Thread(target=lambda: bodies.append(free_bodies()))
    other.start()
    other.join()
    assert free_bodies() is free_bodies()
    assert free_bodies() is not bodies[0]


@pytest.mark.parametrize("course", [0.0, 0.7, 2.0, -2.5])
def test_a_velocity_is_reached_in_any_direction_and_the_heading_kept(course):
    flight = Flight([upright((0, 0, 5), 0.3)])
    wanted = [8 * np.cos(course), 8 * np.sin(course), 1.0]
    state = flight.fly([*wanted, 0.0], 2.0)[0]
    np.testing.assert_allclose(state[7:10], wanted, atol=0.1)
    swung = np.abs(headings(np.concatenate(flight.path)) - 0.3)
    assert swung.max() < np.deg2rad(10)
    assert swung[-1] < np.deg2rad(0.5)


def test_it_turns_while_it_leans():
    flight = Flight([upright((0, 0, 5), 0.0)])
    flight.fly([9.0, 0.0, 0.0, 0.0], 1.5)
    flight.fly([0.0, 9.0, 0.0, 1.5], 1.0)
    assert headings(flight.states)[0] == pytest.approx(1.5, abs=0.12)
    assert abs(flight.states[0, 2] - 5) < 0.5


def test_it_hovers_where_it_is():
    flight = Flight([upright((1, 2, 3), -1.0)])
    np.testing.assert_allclose(flight.fly([0, 0, 0, 0], 2.0)[0, :3], [1, 2, 3], atol=0.01)


def test_it_sinks_while_it_turns_as_fast_as_it_can():
    flight = Flight([upright((0, 0, 9), 0.0)])
    for turn in (4.0, -4.0) * 4:
        flight.fly([6.0, 0.0, -3.0, turn], 0.1)
    speed = np.concatenate(flight.path)[SIMULATION_HZ // 2 :, 9]
    assert (speed < -2.0).all()
    assert (np.diff(np.concatenate(flight.path)[:, 2]) <= 1e-3).all()
