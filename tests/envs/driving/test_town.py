from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from highway_env.road.lane import LineType, SineLane
from highway_env.utils import wrap_to_pi

from sada_gym.envs.driving.world.route import (
    COMMANDS,
    ROUTES,
    SPACING_M,
    benchmark_routes,
    make_route,
    random_route,
)
from sada_gym.envs.driving.world.town import local_coordinates, town

LAYOUTS = ["benchmark", "training"]


@pytest.mark.parametrize("name", LAYOUTS)
def test_lanes_join_without_a_gap_or_a_kink(name):
    place = town(name)
    for (before, corner, after), passage in place.passages.items():
        way = [place.streets[before, corner], *passage.lanes, place.streets[corner, after]]
        for lane, other in pairwise(way):
            gap = lane.position(lane.length, 0) - other.position(0, 0)
            assert np.hypot(*gap) < 1e-9
            assert abs(wrap_to_pi(lane.heading_at(lane.length) - other.heading_at(0))) < 1e-9


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_car_can_turn_as_tightly_as_every_lane(name):
    tightest = 2.5 / np.sin(np.arctan(0.5))  # at 45 degrees of steering
    for lane in town(name).network.lanes_list():
        assert getattr(lane, "radius", np.inf) > 1.1 * tightest


@pytest.mark.parametrize("name", LAYOUTS)
def test_there_are_junctions_of_three_and_four_streets_and_bends(name):
    layout = town(name).layout
    kinds = Counter(len(layout.neighbours(corner)) for corner in layout.corners)
    assert set(kinds) == {2, 3, 4}
    assert min(kinds.values()) >= 2


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_network_of_highway_env_knows_all_ways(name):
    place = town(name)
    corners = list(place.layout.corners)
    for goal in corners[1:]:
        aim = f"{goal}>{place.layout.neighbours(goal)[0]}/start"
        assert place.network.shortest_path("A0>B0/start", aim)


def test_every_street_has_one_middle_line():
    place = town("benchmark")
    for a, b in place.layout.streets:
        lines = [place.streets[pair].line_types[0] for pair in ((a, b), (b, a))]
        assert sorted(lines) == [LineType.NONE, LineType.STRIPED]


def test_lane_coordinates_of_many_points_are_highway_envs():
    rng = np.random.default_rng(0)
    for lane in town("training").network.lanes_list():
        along, lateral = rng.uniform(0, lane.length, 5), rng.uniform(-3, 3, 5)
        points = np.array([lane.position(s, r) for s, r in zip(along, lateral, strict=True)])
        np.testing.assert_allclose(local_coordinates(lane, points), (along, lateral), atol=1e-9)
        theirs = np.transpose([lane.local_coordinates(point) for point in points])
        np.testing.assert_allclose(local_coordinates(lane, points), theirs, atol=1e-9)


def test_a_lane_of_another_kind_is_refused():
    with pytest.raises(TypeError, match="Expected a straight or circular lane, got SineLane"):
        local_coordinates(SineLane([0, 0], [9, 0], 1.0, 1.0, 0.0), np.zeros((1, 2)))


def test_a_route_follows_the_lanes_evenly():
    route = make_route(town("benchmark"), ("A1", "B1", "B0"))
    steps = np.linalg.norm(np.diff(route.points, axis=0), axis=1)
    np.testing.assert_allclose(steps, SPACING_M, rtol=2e-3)  # chords of arcs
    assert len(route.heading) == len(route.command) == len(route.points)
    direction = np.arctan2(*np.diff(route.points, axis=0).T[::-1])
    assert np.abs(wrap_to_pi(direction - route.heading[:-1])).max() < 0.05


@pytest.mark.parametrize(
    ("way", "command"), [("A1 B1 B0", "left"), ("A1 B1 B2", "right"), ("A1 B1 C1", "straight")]
)
def test_a_command_is_given_before_and_in_a_junction(way, command):
    place = town("benchmark")
    route = make_route(place, tuple(way.split()), start=0.0)
    commands = [COMMANDS[c] for c in route.command]
    assert commands[0] == commands[-1] == "follow"
    first = commands.index(command)
    last = len(commands) - commands[::-1].index(command)
    assert set(commands[first:last]) == {command}
    entry = place.streets["A1", "B1"].length
    inside = sum(lane.length for lane in place.passages[tuple(way.split())].lanes)
    assert first * SPACING_M == pytest.approx(entry - 15, abs=SPACING_M)
    assert last * SPACING_M == pytest.approx(entry + inside, abs=SPACING_M)


def test_a_bend_needs_no_command():
    route = make_route(town("benchmark"), ("B0", "A0", "A1"), start=0.5)
    assert not route.command.any()
    assert abs(route.heading[-1] - route.heading[0]) > 1.2


def test_a_street_that_is_missing_is_named():
    with pytest.raises(ValueError, match=r"from C1 to D1, got none\. From C1 streets lead"):
        make_route(town("benchmark"), ("C1", "D1"))


def test_random_routes_never_turn_back_and_differ():
    rng = np.random.default_rng(0)
    routes = [random_route(town("training"), rng, 3) for _ in range(30)]
    for route in routes:
        assert all(a != b for a, b in zip(route.corners, route.corners[2:], strict=False))
    assert len({route.corners for route in routes}) > 20


def test_tasks_are_what_their_names_say():
    turns = {
        task: [
            [COMMANDS[c] for c in sorted({*route.command.tolist()})]
            for route in benchmark_routes(task)
        ]
        for task in ROUTES
    }
    assert turns["straight"] == [["follow", "straight"]] * 5
    counts = Counter(tuple(commands) for commands in turns["one_curve"])
    assert counts == {("follow", "left"): 2, ("follow", "right"): 2, ("follow",): 1}
    ways = [route.command for route in benchmark_routes("navigation")]
    begun = Counter(
        COMMANDS[b] for way in ways for a, b in pairwise(way.tolist()) if b != a and b != 0
    )
    assert begun == {"left": 6, "right": 7, "straight": 2}
    assert all(len(routes) == 5 for routes in map(benchmark_routes, ROUTES))


def test_an_unknown_task_lists_the_known_ones():
    with pytest.raises(ValueError, match="among straight, one_curve, navigation, got 'parking'"):
        benchmark_routes("parking")
