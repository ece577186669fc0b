import math

import numpy as np
import pymunk
import pytest

from sada_gym.envs.robot.world.floor_plan import HALL_M, floor_plan
from sada_gym.envs.robot.world.geometry import clearance
from sada_gym.envs.robot.world.lidar import RANGE_M, RAYS, SCANS, SECTORS, distance, nearest, scan

HALL = np.array(HALL_M)
NO_RACKS, NO_CIRCLES = np.zeros((1, 0, 4)), np.zeros((1, 0, 3))


def test_ranges_are_those_of_pymunks_queries():
    rng = np.random.default_rng(0)
    for number in range(10):
        plan = floor_plan(number)
        circles = np.concatenate([plan.pillars, plan.barrels])
        space = pymunk.Space()
        ground, (width, height) = space.static_body, HALL_M
        corners = [(0, 0), (width, 0), (width, height), (0, height)]
        shapes = [pymunk.Segment(ground, corners[k - 1], corners[k], 0) for k in range(4)]
        shapes += [
            pymunk.Poly(ground, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
            for x0, y0, x1, y1 in plan.racks
        ]
        shapes += [pymunk.Circle(ground, radius, (x, y)) for x, y, radius in circles]
        space.add(*shapes)
        for _ in range(100):
            x, y = rng.uniform(0, 1, 2) * HALL_M
            if clearance(x, y, HALL, plan.racks, circles) < 0.05:
                continue
            angle = rng.uniform(0, 2 * np.pi)
            dx, dy = math.cos(angle), math.sin(angle)
            end = (x + RANGE_M * dx, y + RANGE_M * dy)
            hit = space.segment_query_first((x, y), end, 0, pymunk.ShapeFilter())
            expected = RANGE_M if hit is None else hit.alpha * RANGE_M
            ranges = distance(x, y, dx, dy, HALL, plan.racks, circles)
            assert ranges == pytest.approx(expected, abs=1e-6)


def scanned(pose, mount=(0.0, 0.0), circles=NO_CIRCLES, noise=0.0, lost=False):
    points = np.zeros((1, RAYS, 2))
    scan(
        np.array([pose]),
        np.array([mount]),
        HALL,
        NO_RACKS,
        circles,
        np.full((1, RAYS), noise),
        np.full((1, RAYS), lost),
        points,
    )
    return points


def test_a_well_mounted_lidar_returns_what_is_there():
    points = scanned((2.0, 3.0, 0.3))[0]
    seen = points[np.isfinite(points[:, 0])]
    assert len(seen) > RAYS // 3
    away = [clearance(x, y, HALL, NO_RACKS[0], NO_CIRCLES[0]) for x, y in seen]
    np.testing.assert_allclose(away, 0.0, atol=1e-9)


def test_a_turned_lidar_shows_things_turned_to_the_other_side():
    ahead = np.array([[[3.0, 4.0, 0.2]]])  # 1 m ahead of a robot at (2, 4)
    straight = nearest(
        np.array([[2.0, 4.0, 0.0]]), scanned((2.0, 4.0, 0.0), circles=ahead)[:, None]
    )
    turned = nearest(
        np.array([[2.0, 4.0, 0.0]]),
        scanned((2.0, 4.0, 0.0), (math.radians(20), 0.0), ahead)[:, None],
    )
    assert straight[0].argmax() == 0
    assert turned[0].argmax() == SECTORS - 2  # 20 degrees to the right
    assert straight.max() == pytest.approx(1 - 0.8 / RANGE_M, abs=1e-3)


def test_a_lidar_to_the_left_shows_things_too_far_to_the_right():
    ahead = np.array([[[2.6, 4.0, 0.1]]])
    points = scanned((2.0, 4.0, 0.0), (0.0, 0.15), ahead)[0]
    near = points[np.hypot(points[:, 0] - 2.0, points[:, 1] - 4.0) < 0.7]
    assert len(near)
    assert (near[:, 1] < 4.0).all()


def test_noise_and_lost_rays():
    exact, noisy = scanned((2.0, 3.0, 0.3)), scanned((2.0, 3.0, 0.3), noise=0.1)
    further = np.hypot(*(noisy - (2.0, 3.0)).T) - np.hypot(*(exact - (2.0, 3.0)).T)
    np.testing.assert_allclose(further[np.isfinite(further)], 0.1, atol=1e-9)
    assert np.isnan(scanned((2.0, 3.0, 0.3), lost=True)).all()


def test_sectors_take_the_nearest_of_all_scans():
    points = np.full((1, SCANS, RAYS, 2), np.nan)
    points[0, 0, 0], points[0, 3, 7] = (4.0, 4.0), (3.0, 4.0)
    points[0, 1, 3] = (2.0, 5.0)
    sectors = nearest(np.array([[2.0, 4.0, 0.0]]), points)[0]
    assert sectors[0] == pytest.approx(1 - 1 / RANGE_M)
    assert sectors[SECTORS // 4] == pytest.approx(1 - 1 / RANGE_M)
    assert np.count_nonzero(sectors) == 2
