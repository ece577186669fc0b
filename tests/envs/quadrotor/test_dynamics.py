"""The rigid body against the simulator of RAPTOR's authors, and by itself."""

from pathlib import Path

import numpy as np
import pytest

from sada_gym.envs.quadrotor.start import GRAVITY_M_S2, PARAMETERS, PLATFORMS, QuadrotorStart
from sada_gym.envs.quadrotor.world.dynamics import (
    DEPTH_M,
    HEIGHT_M,
    MEASURED,
    RAMP_S,
    STEP_S,
    WIDTH_M,
    fly,
    measure,
    observe,
    reference,
)

CALM = np.zeros(3)


def conditions(**changed):
    """The middles of all ranges, without load, weak motor, air and faults, but for what changes."""
    middle = PARAMETERS.describe(np.zeros(len(PARAMETERS)))
    nothing = ("load_ahead", "load_left", "weak_motor", "wind_m_s", "gust_m_s", "noise_m")
    return {**middle, **dict.fromkeys((*nothing, "delay_s"), 0.0), **changed}


def hovering(start):
    state = np.zeros(17)
    state[[2, 3]] = HEIGHT_M, 1.0
    state[13:] = start.hover
    return state


def flown(state, action, start, steps, wind=CALM):
    body, motors = start.airframe()
    for _ in range(steps):
        fly(state, np.asarray(action, float), body, motors, wind)
    return state


def test_flights_are_those_of_the_authors_simulator():
    # l2f computes in float32; studies/quadrotor_l2f.py made its flights
    with np.load(Path(__file__).with_name("l2f.npz")) as file:
        flights = [file[name] for name in ("bodies", "motors", "actions", "states")]
    for body, motors, actions, states in zip(*flights, strict=True):
        state = states[0].astype(np.float64)
        for action, expected in zip(actions, states[1:], strict=True):
            fly(state, action.astype(np.float64), body, motors.ravel(), CALM)
            np.testing.assert_allclose(state, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("mu", [-1.0, 0.0, 1.0])
def test_a_quadrotor_hovers(platform, mu):
    values = PARAMETERS.describe(np.full(len(PARAMETERS), mu))
    names = ("mass_ratio", "arm_ratio", "thrust_to_weight", "torque_to_inertia")
    start = QuadrotorStart(platform, conditions(**{name: values[name] for name in names}), 0)
    state = flown(hovering(start), [2 * start.hover - 1] * 4, start, 100)
    np.testing.assert_allclose(state, hovering(start), atol=1e-9)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_thrust_and_turning_are_what_their_names_say(platform):
    start = QuadrotorStart(platform, conditions(thrust_to_weight=2.0, torque_to_inertia=300.0), 0)
    state = hovering(start)
    state[13:] = 1.0
    risen = flown(state.copy(), [1.0] * 4, start, 1)
    assert risen[9] / STEP_S == pytest.approx(GRAVITY_M_S2, rel=0.01)
    # at full throttle on the left, at rest on the right: two motors roll it about x, and the middle
    # is nearer to x than to a motor by a square root of 2; a Crazyflie's pull a little even at rest
    state[13:] = 0.0, 0.0, 1.0, 1.0
    rolled = flown(state.copy(), [-1.0, -1.0, 1.0, 1.0], start, 1)
    assert rolled[10] / STEP_S == pytest.approx(300.0 * np.sqrt(2.0), rel=0.04)


def test_loads_weak_motors_and_wind_push_to_their_sides():
    def change(wind=CALM, **changed):
        start = QuadrotorStart("x500", conditions(**changed), 0)
        return flown(hovering(start), [2 * start.hover - 1] * 4, start, 5, np.array(wind))

    assert change(load_ahead=0.1)[11] > 0.01  # the nose goes down
    assert change(load_left=0.1)[10] < -0.01  # the left side goes down
    weak = change(weak_motor=0.2)
    assert weak[11] > 0.01  # the nose, and ...
    assert weak[10] > 0.01  # the right side go down
    blown = change([5.0, 0.0, 0.0])[7:10]
    assert blown[0] == pytest.approx(5 * 0.01 * 5 * 0.3 / 1.1, rel=0.05)
    assert abs(blown[1:]).max() < 1e-9


def test_the_reference_gets_faster_and_flies_a_figure_of_eight():
    times = np.arange(0.0, 12.0, 1e-3)
    ways = np.array([reference(time_s, 1.5) for time_s in times])
    np.testing.assert_allclose(
        np.gradient(ways[:, :2], times, axis=0)[1:-1], ways[1:-1, 2:], atol=5e-3
    )
    speed = np.hypot(*ways[:, 2:].T)
    assert speed[0] == 0.0
    assert speed[times < RAMP_S].max() < 1.5
    assert speed.max() == pytest.approx(1.5, abs=1e-3)
    np.testing.assert_allclose(abs(ways[:, :2]).max(axis=0), [WIDTH_M, DEPTH_M], atol=1e-3)
    assert reference(9.0, 0.0) == (0.0, 0.0, 0.0, 0.0)


def test_what_is_measured_is_noisy_and_old():
    state = hovering(QuadrotorStart("x500", conditions(), 0))
    state[:3] += [0.2, -0.1, 2.0]
    state[7], state[12] = 1.0, 0.5
    seen = np.zeros(MEASURED)
    noise = np.ones(MEASURED, np.float32)
    measure(state, np.array([0.1, 0.0, 0.4, 0.0]), noise, 0.0, seen)
    np.testing.assert_allclose(seen[:3], [0.1, -0.1, 2.0])
    np.testing.assert_allclose(seen[3:12], np.eye(3).ravel())
    np.testing.assert_allclose(seen[12:], [0.6, 0, 0, 0, 0, 0.5])
    noisy = np.zeros(MEASURED)
    measure(state, np.array([0.1, 0.0, 0.4, 0.0]), noise, 0.01, noisy)
    np.testing.assert_allclose(noisy - seen, [0.01] * 12 + [0.02] * 6)
    kept, flights = np.stack([seen, 3 * seen, 5 * seen])[None], np.zeros((1, 5))
    observed, actions = np.zeros((1, 22), np.float32), np.array([[0.1, 0.2, 0.3, 0.4]])
    for delay, factor in ((0.0, 1.0), (0.005, 2.0), (0.01, 3.0)):
        flights[0, 3] = delay
        observe(np.array([0]), kept, flights, actions, observed)
        np.testing.assert_allclose(observed[0, :2], factor * seen[:2], rtol=1e-6)
        np.testing.assert_allclose(observed[0, 15:18], factor * seen[15:], rtol=1e-6)
    np.testing.assert_allclose(observed[0, 18:], actions[0], rtol=1e-6)
    # errors are cut off as PX4 does
    np.testing.assert_allclose(observed[0, [2, 12]], [0.5, 1.0])
