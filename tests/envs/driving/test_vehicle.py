import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from sada_gym.envs.driving.world.vehicle import drive, locate


def test_paths_are_those_of_highway_envs_vehicle():
    rng = np.random.default_rng(0)
    states = np.array([[0.0, 0.0, 0.3, 5.0], [10.0, -4.0, -2.0, 8.0], [3.0, 3.0, 1.5, 2.0]])
    vehicles = [Vehicle(None, [x, y], heading, speed) for x, y, heading, speed in states]
    for _ in range(500):
        steering = rng.uniform(-0.7, 0.7, 3)
        acceleration = 8.0 - states[:, 3] + rng.uniform(-3, 3, 3)  # never to a standstill
        drive(states, steering, acceleration, 1 / 15, 1)
        for vehicle, wheel, pedal in zip(vehicles, steering, acceleration, strict=True):
            vehicle.act({"steering": wheel, "acceleration": pedal})
            vehicle.step(1 / 15)
    theirs = [[*v.position, v.heading, v.speed] for v in vehicles]
    np.testing.assert_allclose(states, theirs, rtol=0, atol=1e-9)


def test_nobody_drives_much_faster_than_highway_env_lets_them():
    states = np.array([[0.0, 0.0, 0.1, 39.5], [0.0, 9.0, 0.0, 44.0]])
    vehicles = [Vehicle(None, [x, y], heading, speed) for x, y, heading, speed in states]
    fastest = 0.0
    for _ in range(300):
        drive(states, np.full(2, 0.01), np.full(2, 5.0), 1 / 15, 1)
        for vehicle in vehicles:
            vehicle.act({"steering": 0.01, "acceleration": 5.0})
            vehicle.step(1 / 15)
        fastest = states[:, 3].max()
    theirs = [[*v.position, v.heading, v.speed] for v in vehicles]
    np.testing.assert_allclose(states, theirs, rtol=0, atol=1e-9)
    assert fastest < 40.5


def test_brakes_stop_a_car_and_do_not_reverse_it():
    states = np.array([[0.0, 0.0, 0.0, 3.0]])
    drive(states, np.zeros(1), np.full(1, -5.0), 1 / 15, 30)
    assert states[0, 3] == 0.0
    assert 0.5 < states[0, 0] < 1.5


def test_a_car_is_found_on_its_route_to_either_side():
    points = np.column_stack([np.arange(0, 20, 0.5), np.zeros(40)])
    states = np.array([[3.1, 1.2, 0.0, 0.0], [3.1, -1.2, 0.0, 0.0]])
    at = np.array([2, 3])
    along, lateral = locate(states, points, np.zeros(40), np.zeros(2, int), np.full(2, 39), at)
    assert at.tolist() == [6, 6]
    np.testing.assert_allclose(along, [0.1, 0.1])
    np.testing.assert_allclose(lateral, [1.2, -1.2])


def test_a_car_stays_on_its_own_part_of_a_route_that_crosses_itself():
    path = np.column_stack([np.arange(0, 20, 0.5), np.zeros(40)])
    back = np.column_stack([np.full(40, 10.0), np.arange(-10, 10, 0.5)])
    points = np.concatenate([path, back])
    at = np.array([58])
    states = np.array([[10.0, 0.1, np.pi / 2, 0.0]])
    heading = np.repeat([0.0, np.pi / 2], 40)
    locate(states, points, heading, np.zeros(1, int), np.full(1, 79), at)
    assert at.tolist() == [60]
