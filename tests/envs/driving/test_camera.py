import numpy as np
import pytest

from sada_gym.envs.driving.camera.casting import MOST_HITS, cast
from sada_gym.envs.driving.camera.pinhole import Lens, Mount, camera
from sada_gym.envs.driving.camera.scenery import BUILDING, TREE
from sada_gym.envs.driving.episodes import DriveDistribution
from sada_gym.envs.driving.world.route import make_route
from sada_gym.envs.driving.world.town import LANE_WIDTH_M, local_coordinates, town
from sada_gym.envs.driving.world.weather import NAMES, WEATHERS, weather_index

LENS = Lens(44, 100)


def look(poses, *, pitch=-15.0, weather=0, keys=None, lens=LENS):
    """Pictures of cameras at x, y, heading, height."""
    poses = np.atleast_2d(np.asarray(poses, float))
    n = len(poses)
    weathers = np.broadcast_to(weather, n).astype(np.int64)
    keys = np.zeros(n, np.uint64) if keys is None else np.asarray(keys, np.uint64)
    of = camera("benchmark")
    return of.draw(lens, lens.rays(pitch)[None], np.zeros(n, np.int64), poses, weathers, keys)


@pytest.fixture(scope="module")
def poses():
    route = make_route(town("benchmark"), ("A2", "B2", "C2", "C1"))
    rows = np.arange(0, len(route.points), 23)
    return np.column_stack([route.points[rows], route.heading[rows], np.full(len(rows), 1.4)])


def test_rays_through_the_middle_look_along_the_axis():
    rays = Lens(45, 101).rays(-15.0)
    forward, right, slope, _ = rays[22, 50]
    assert forward == pytest.approx(1.0)
    assert right == pytest.approx(0.0, abs=1e-6)
    assert np.rad2deg(np.arctan(slope)) == pytest.approx(-15.0)


def test_rays_at_the_sides_open_the_field_of_view():
    forward, right, _, _ = Lens(45, 101).rays(0.0)[22, -1]
    half = np.rad2deg(np.arctan2(right, forward))
    assert half == pytest.approx(50.0, abs=0.3)


@pytest.mark.parametrize("pitch", [-20.0, -10.0])
def test_the_fan_of_planes_holds_all_rays(pitch):
    plane = LENS.rays(pitch)[..., 3]
    assert plane.min() >= 0
    assert plane.max() < LENS.planes
    assert len(np.unique(plane)) > 80


def test_a_picture_does_not_depend_on_the_others_in_the_batch(poses):
    weathers = np.arange(len(poses)) % len(NAMES)
    keys = np.arange(len(poses))
    together = look(poses, weather=weathers, keys=keys)
    for i in reversed(range(len(poses))):
        alone = look(poses[i], weather=weathers[i], keys=keys[i : i + 1])
        np.testing.assert_array_equal(alone[0], together[i])


def test_each_weather_looks_different(poses):
    pictures = np.array([look(poses, weather=w) for w in range(len(NAMES))]).astype(float)
    for i in range(len(NAMES)):
        for j in range(i):
            assert np.abs(pictures[i] - pictures[j]).mean() > 4, (NAMES[i], NAMES[j])


def test_height_and_pitch_change_the_picture(poses):
    as_trained = look(poses).astype(float)
    higher = np.add(poses, [0, 0, 0, 0.3])
    assert np.abs(look(higher) - as_trained).mean() > 2
    assert np.abs(look(poses, pitch=-13.0) - as_trained).mean() > 2


def test_only_rain_is_random(poses):
    for name, weather in WEATHERS.items():
        index = weather_index(name)
        first, other = (look(poses[:2], weather=index, keys=[k, k + 1]) for k in (3, 8))
        assert np.array_equal(first, other) == (weather.rain == 0), name


def test_what_is_near_stays_where_geometry_puts_it():
    """The stop line, 8 m before the camera, shows in the row that its distance gives."""
    street = town("benchmark").streets["A2", "B2"]
    along = street.length - 4.45 - 8.0
    x, y = street.position(along, 0.0)
    picture = look([x, y, street.heading, 1.4]).astype(float)[0]
    distance = 8.0 - 2.0  # the camera stands 2 m before the car's middle
    pitch = np.deg2rad(-15.0)
    below = np.arctan2(1.4, distance) + pitch
    row = np.tan(below) / LENS.pixel + LENS.rows / 2
    brightness = picture[:, 45:56].mean(axis=(1, 2))
    # between the line and the crossing beyond it, which is brighter still, look near the row only
    near = np.arange(int(row) - 1, int(row) + 3)
    peak = near[brightness[near].argmax()]
    assert abs(peak + 0.5 - row) < 1.2
    assert brightness[peak] > brightness[int(row) + 4] + 25


def test_a_ray_meets_a_wall_at_its_distance_and_place():
    of = camera("benchmark")
    objects = of.scenery.objects
    i = int(np.flatnonzero(objects[:, 0] == BUILDING)[0])
    centre, axis, half = objects[i, 1:3], objects[i, 3:5], objects[i, 5]
    start = centre + (half + 1.0) * axis
    hits = np.zeros((MOST_HITS, 4))
    count = cast(*start, *-axis, 50.0, of.town, hits)
    assert count >= 1
    assert hits[0].tolist() == pytest.approx([1.0, i, 0.0, 1.0], abs=1e-9)


def test_hits_come_nearest_first_and_each_object_once():
    of = camera("benchmark")
    rng = np.random.default_rng(0)
    hits = np.zeros((MOST_HITS, 4))
    most = 0
    for _ in range(200):
        x, y = rng.uniform([0, 0], [330, 240])
        angle = rng.uniform(0, 2 * np.pi)
        count = cast(x, y, np.cos(angle), np.sin(angle), 160.0, of.town, hits)
        assert (np.diff(hits[:count, 0]) >= 0).all()
        assert len(set(hits[:count, 1])) == count
        most = max(most, count)
    assert most == MOST_HITS


def test_nothing_stands_on_a_road():
    for name in ("benchmark", "training"):
        objects = camera(name).scenery.objects
        trees, buildings = (objects[objects[:, 0] == kind] for kind in (TREE, BUILDING))
        assert len(trees) > 150
        assert len(buildings) > 60
        for lane in town(name).network.lanes_list():
            for group, clear in ((trees, 2.5), (buildings, 5.0)):
                along, lateral = local_coordinates(lane, group[:, 1:3])
                beside = (along > 0) & (along < lane.length)
                assert np.abs(lateral[beside]).min(initial=99.0) > clear - LANE_WIDTH_M / 2 + 1.0


def test_the_ground_shows_asphalt_lines_and_grass():
    of = camera("benchmark")
    street = town("benchmark").streets["A1", "B1"]

    def albedo(lateral, along=20.0):
        row, column = (
            (street.position(along, lateral) - of.ground.origin) / of.ground.texel_m
        ).astype(int)[::-1]
        return of.plan(0)[row, column].astype(int)

    asphalt, edge, grass = albedo(0.0), albedo(LANE_WIDTH_M / 2), albedo(9.0)
    assert edge.min() > asphalt.max() + 40
    assert np.ptp(asphalt) < 15
    assert grass[1] > grass[0] > grass[2]


def test_an_unknown_weather_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"among ClearNoon, WetNoon, HardRainNoon, .*got 'Snow'"):
        DriveDistribution(weathers=("Snow",))


def test_a_mount_is_by_default_that_of_the_paper():
    assert Mount() == Mount(height_m=1.4, pitch_deg=-15.0)
