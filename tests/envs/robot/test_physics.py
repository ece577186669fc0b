import numpy as np
import pytest

from sada_gym.envs.robot.world.robot import (
    GRAVITY_M_S2,
    MASS_KG,
    STALL_N,
    TOP_M_S,
    TRACK_M,
    velocities,
)

STEP_S = 0.04


def driven(rims, steps=100, friction=0.6, payload=(0.0, 0.0), gain=0.0, velocity=(0.0, 0.0, 0.0)):
    """The velocities (steps, 3) of one robot that looks along x at first."""
    return velocities(
        np.zeros((1, 3)),
        np.array([velocity]),
        np.array([payload]),
        np.array([friction]),
        np.array([gain]),
        np.tile(rims, (1, steps, 1)).astype(float),
        STEP_S,
    )[0]


def test_it_drives_as_fast_as_commanded():
    np.testing.assert_allclose(driven([0.5, 0.5])[-1], [0.5, 0.0, 0.0], atol=1e-6)


def test_the_motors_get_no_faster_than_their_no_load_speed():
    assert 0.9 * TOP_M_S < driven([2.0, 2.0])[-1, 0] <= TOP_M_S
    assert pytest.approx(0.736, abs=1e-3) == TOP_M_S
    assert pytest.approx(46.75, abs=0.01) == STALL_N


def test_it_turns_as_commanded_and_to_the_left_where_the_right_wheel_is_faster():
    turning = driven([0.1, 0.3])
    assert turning[-1, 2] == pytest.approx(0.2 / (2 * TRACK_M), rel=1e-6)
    assert np.hypot(*turning[-1, :2]) == pytest.approx(0.2, rel=1e-6)


def test_a_worn_wheel_makes_it_turn():
    assert driven([0.5, 0.5], gain=0.1)[-1, 2] == pytest.approx(0.1 / (2 * TRACK_M), rel=1e-6)


@pytest.mark.parametrize("friction", [0.05, 0.2])
def test_brakes_are_as_good_as_the_floor(friction):
    speeds = driven([0.0, 0.0], steps=1, friction=friction, velocity=(0.6, 0.0, 0.0))[:, 0]
    np.testing.assert_allclose(0.6 - speeds, friction * GRAVITY_M_S2 * STEP_S, rtol=1e-9)


def test_a_payload_takes_longer_to_speed_up():
    # where the floor holds, the motors' force decides
    light, heavy = (driven([0.6, 0.6], 1, 5.0, (kg, 0.0))[0, 0] for kg in (0.0, 5.0))
    assert light / heavy == pytest.approx((MASS_KG + 5) / MASS_KG)


def test_a_payload_off_the_axle_takes_weight_from_the_wheels():
    at_axle, ahead = (
        driven([0.0, 0.0], 1, 0.1, (5.0, offset), velocity=(0.6, 0.0, 0.0))[0, 0]
        for offset in (0.0, 0.1)
    )
    assert 0.6 - ahead < 0.7 * (0.6 - at_axle)


def test_on_a_slippery_floor_it_slides_on_in_a_bend():
    def sideways(friction):
        heading, slid = 0.0, []
        for vx, vy, turning in driven([0.2, 0.5], 40, friction, velocity=(0.6, 0.0, 0.0)):
            slid.append(abs(-vx * np.sin(heading) + vy * np.cos(heading)))
            heading += turning * STEP_S
        return max(slid)

    assert sideways(0.05) > 0.01 > 0.001 > sideways(0.6)
