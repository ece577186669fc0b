import pickle
from dataclasses import replace

import numpy as np
import pytest

from sada_gym.envs.episodes.base import play, record
from sada_gym.envs.robot.agent.privileged import PrivilegedDriver
from sada_gym.envs.robot.episodes import GRACE_S, SLOWEST_M_S, RobotEpisodes
from sada_gym.envs.robot.start import (
    NOMINAL,
    PARAMETERS,
    POLICY_HZ,
    Conditions,
    RobotEnd,
    RobotStart,
    TripDistribution,
    conditions,
)
from sada_gym.envs.robot.world.carts import SEES_M
from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M, floor_plan
from sada_gym.envs.robot.world.geometry import clearance
from sada_gym.envs.robot.world.robot import RADIUS_M

FIRST = np.zeros(1, np.intp)


class Still:
    fingerprint = "still"

    def start(self, count):
        pass

    def act(self, trips, which):
        return np.tile([0.0, 0.0], (len(which), 1))


class Blind(Still):
    """Follows its way and looks at nothing."""

    def act(self, trips, which):
        state = trips.observe(which)["state"]
        angle = np.arctan2(state[:, 3], state[:, 2])
        return np.column_stack([np.where(abs(angle) < 0.8, 0.9, 0.0), np.clip(2 * angle, -1, 1)])


def draw(count, distribution=None, seed=0):
    rng = np.random.default_rng(seed)
    return [(distribution or TripDistribution()).draw(rng) for _ in range(count)]


def gap(trips, i):
    """The least gap between a robot and anything, by geometry alone."""
    start, (x, y, _) = trips.starts[i], trips.poses[i]
    carts = np.column_stack([trips.carts[i], np.full(len(trips.carts[i]), CART_RADIUS_M)])
    barrels = start.plan.barrels[: start.conditions.barrels]
    circles = np.concatenate([start.plan.pillars, barrels, carts[: len(start.plan.lanes)]])
    return clearance(x, y, np.array(HALL_M), start.plan.racks, circles) - RADIUS_M


def test_contacts_end_trips_where_geometry_finds_them():
    trips = RobotEpisodes(draw(60))
    gaps = []

    def look(now):
        gaps.append([gap(now, i) for i in now.under_way()])

    play(Blind(), trips, look)
    collided = np.flatnonzero(trips.ending == RobotEnd.COLLIDED)
    assert len(collided) > 5
    assert (trips.ending == RobotEnd.ARRIVED).sum() > 20
    assert min(map(min, gaps)) > -1e-6
    assert max(gap(trips, i) for i in collided) < 0.005
    np.testing.assert_array_equal(trips.score, trips.ending == RobotEnd.ARRIVED)


def test_who_stands_still_is_too_late_and_touches_nothing():
    (start,) = draw(1)
    trips = RobotEpisodes([start])
    play(Still(), trips)
    assert trips.ending[0] == RobotEnd.TOO_LATE
    length = 0.1 * (len(start.plan.ways[start.trip]) - 1)
    assert trips.steps[0] == np.ceil((length / SLOWEST_M_S + GRACE_S) * POLICY_HZ)
    assert trips.remaining_m[0] == pytest.approx(length, abs=0.1)


@pytest.mark.parametrize(("latency_s", "still_for"), [(0.0, 0), (0.2, 1), (0.6, 3)])
def test_a_command_takes_its_latency(latency_s, still_for):
    trips = RobotEpisodes([RobotStart(conditions=replace(NOMINAL, latency_s=latency_s))])
    speeds = []
    for _ in range(6):
        trips.step(FIRST, np.array([[1.0, 0.0]]))
        speeds.append(np.hypot(*trips.velocities[0, :2]))
    assert speeds[:still_for] == [0.0] * still_for
    assert min(speeds[still_for:]) > 0.0


def test_carts_drive_to_and_fro_and_wait_for_the_robot():
    trips = RobotEpisodes([replace(start, conditions=NOMINAL) for start in draw(20)])
    rollouts = record(Still(), trips)
    moved = 0
    for rollout in rollouts:
        carts, count = rollout["carts"], len(rollout.start.plan.lanes)
        for k in range(count):
            speed = np.hypot(*np.diff(carts[:, k], axis=0).T) * POLICY_HZ
            away = np.hypot(*(carts[:-1, k] - rollout["poses"][:-1, :2]).T)
            assert (speed[away < SEES_M] == 0).all()
            assert (speed[away >= SEES_M] <= 0.25 + 1e-9).all()
            moved += (np.diff(np.sign(np.diff(carts[:, k, 0]))) != 0).any()
    assert moved > 10


def test_a_trip_is_the_same_whatever_else_is_in_the_batch():
    starts = draw(7, TripDistribution(spread=1.0))
    together = record(Blind(), RobotEpisodes(starts))
    alone = [record(Blind(), RobotEpisodes([start]))[0] for start in starts[::-1]][::-1]
    for batched, two in zip(together, alone, strict=True):
        for key in batched.snapshots:
            np.testing.assert_array_equal(batched[key], two[key])


def test_a_place_is_used_again_as_if_it_were_new():
    first, second = draw(2, TripDistribution(spread=1.0))
    trips = RobotEpisodes([first, first])
    for _ in range(9):
        trips.step(np.arange(2), np.full((2, 2), 0.3))
    trips.begin(1, second)
    fresh = RobotEpisodes([second])
    play(Blind(), trips)
    play(Blind(), fresh)
    np.testing.assert_array_equal(trips.poses[1], fresh.poses[0])
    assert trips.ending[1] == fresh.ending[0]


def test_the_seed_fixes_the_lidars_noise_alone():
    start = RobotStart(conditions=replace(NOMINAL, lidar_noise_m=0.1))
    first, two = RobotEpisodes([start]), RobotEpisodes([replace(start, seed=1)])
    np.testing.assert_array_equal(first.poses, two.poses)
    assert not np.array_equal(first.observe(FIRST)["lidar"], two.observe(FIRST)["lidar"])


def test_the_privileged_driver_arrives():
    trips = RobotEpisodes(draw(20, TripDistribution(spread=1.0)))
    play(PrivilegedDriver(), trips)
    assert (trips.ending == RobotEnd.ARRIVED).sum() >= 19


@pytest.mark.slow
def test_no_floor_plan_is_beyond_the_privileged_driver():
    for first in range(0, 1_000, 50):
        starts = [
            RobotStart(floor_plan(n), trip) for n in range(first, first + 50) for trip in (0, 3)
        ]
        trips = RobotEpisodes(starts)
        play(PrivilegedDriver(), trips)
        arrived = (trips.ending == RobotEnd.ARRIVED).reshape(-1, 2)
        assert arrived.any(axis=1).all()
        assert arrived.mean() > 0.9


def test_conditions_are_what_mu_says():
    middle = conditions(np.zeros(len(PARAMETERS), np.float32))
    assert vars(middle) == pytest.approx(vars(NOMINAL))
    ends = [conditions(np.full(len(PARAMETERS), end, np.float32)) for end in (-1, 1)]
    assert (ends[0].barrels, ends[1].barrels) == (0, 16)
    for parameter in PARAMETERS.parameters:
        values = [getattr(end, parameter.name) for end in ends]
        assert values == pytest.approx([parameter.low, parameter.high])


@pytest.mark.parametrize("name", PARAMETERS.names)
def test_conditions_outside_of_their_ranges_are_refused(name):
    with pytest.raises(ValueError, match=f"Expected {name} from"):
        Conditions(**{name: 99.0})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"spread": 2.0}, "Expected spread from 0 to 1"),
        ({"turned_deg": -1.0}, "Expected turned_deg from 0 to 180"),
        ({"conditions": 3}, "Expected conditions to be a Conditions"),
    ],
)
def test_bad_courses_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        TripDistribution(**settings)


def test_courses_can_be_pickled():
    distribution = TripDistribution(spread=0.5)
    assert pickle.loads(pickle.dumps(distribution)) == distribution
