import numpy as np
import pytest

from sada_gym.envs.robot.world.floor_plan import (
    BARRELS,
    CART_RADIUS_M,
    CARTS,
    GAP_M,
    HALL_M,
    SHUT_M,
    TRIPS,
    floor_plan,
)
from sada_gym.envs.robot.world.geometry import SPACING_M, clearance, rectangle_distance
from sada_gym.envs.robot.world.robot import RADIUS_M

NUMBERS = [*range(40), 2**63 - 1]


def gaps_of(plan):
    """The gaps between each two round things, and of each to walls and racks."""
    width, height = HALL_M
    round_things = np.concatenate([plan.pillars, plan.barrels])
    for i, (x, y, radius) in enumerate(round_things):
        yield from (gap - radius for gap in (x, width - x, y, height - y))
        yield from (rectangle_distance(x, y, rack) - radius for rack in plan.racks)
        for a, b, other in round_things[:i]:
            yield np.hypot(x - a, y - b) - radius - other


@pytest.mark.parametrize("number", NUMBERS)
def test_every_gap_can_be_passed_or_is_plainly_shut(number):
    gaps = np.array(list(gaps_of(floor_plan(number))))
    assert (gaps >= 0).all()
    assert ((gaps < SHUT_M) | (gaps >= GAP_M)).all()
    assert GAP_M > 2 * RADIUS_M + 0.3


@pytest.mark.parametrize("number", NUMBERS)
def test_carts_leave_room_beside_them(number):
    plan = floor_plan(number)
    assert 0 < len(plan.lanes) <= CARTS
    for x0, y0, x1, y1 in plan.lanes:
        assert y0 == y1
        for x in np.linspace(x0, x1, 5):
            none = np.zeros((0, 3))
            least = clearance(x, y0, np.array(HALL_M), plan.racks, none)
            assert CART_RADIUS_M < least < CART_RADIUS_M + SHUT_M
            beside = np.concatenate([plan.pillars, plan.barrels])
            gaps = np.hypot(*(beside[:, :2] - (x, y0)).T) - beside[:, 2] - CART_RADIUS_M
            assert (gaps >= GAP_M - 1e-9).all()


@pytest.mark.parametrize("number", NUMBERS)
def test_trips_follow_one_another_on_ways_that_keep_away_from_what_the_map_shows(number):
    plan = floor_plan(number)
    assert len(plan.ways) == TRIPS
    for before, after in zip(plan.ways, plan.ways[1:], strict=False):
        np.testing.assert_allclose(before[-1], after[0], atol=1e-12)
    for way in plan.ways:
        spacing = np.hypot(*np.diff(way, axis=0).T)
        assert np.abs(spacing - SPACING_M).max() < 0.02
        assert 2.0 < SPACING_M * len(way) < 12.0
        room = [clearance(x, y, np.array(HALL_M), plan.racks, plan.pillars) for x, y in way]
        assert min(room) > RADIUS_M + 0.05
        start_and_goal = way[[0, -1]]
        away = np.hypot(*(start_and_goal[:, None] - plan.barrels[:, :2]).transpose(2, 0, 1))
        assert (away - plan.barrels[:, 2] > 0.45).all()


def test_a_number_says_everything_about_a_plan():
    floor_plan.cache_clear()
    first = floor_plan(3)
    floor_plan.cache_clear()
    again, other = floor_plan(3), floor_plan(4)
    assert again is not first
    np.testing.assert_array_equal(again.barrels, first.barrels)
    for way, two in zip(again.ways, first.ways, strict=True):
        np.testing.assert_array_equal(way, two)
    assert not np.array_equal(other.barrels[:3], first.barrels[:3])


def test_most_plans_have_all_barrels_and_carts():
    plans = [floor_plan(number) for number in range(100)]
    assert np.mean([len(plan.barrels) for plan in plans]) > 0.95 * BARRELS
    assert np.mean([len(plan.lanes) for plan in plans]) > 0.9 * CARTS
