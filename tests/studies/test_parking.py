"""INDAGO's parking: its worlds, the training of its agent, the searches and their measures."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from highway_env.envs.parking_env import ParkingEnv
from stable_baselines3 import SAC

from sada_gym.foundations.determinism import one_thread
from studies import parking as study
from studies import parking_searches as searches
from studies.training.parking import train as training
from studies.training.parking.world import OTHERS, ParkingWorld, World, slots_from


@pytest.fixture(autouse=True)
def _one_thread():
    with one_thread():
        yield


def straight_on(observation):
    return np.array([0.3, 0.0], np.float32)


@pytest.fixture(scope="module")
def application():
    return study.parking(straight_on)


@pytest.fixture(scope="module")
def log():
    """Worlds in which an agent fails where the first slot is taken."""
    rng = np.random.default_rng(0)
    features = np.array([World.drawn(rng).features for _ in range(400)])
    return searches.TrainingLog(features, features[:, 0] > 0.5)


def test_every_world_is_a_mu_and_every_mu_a_world(application):
    rng = np.random.default_rng(1)
    worlds = [World.drawn(rng) for _ in range(50)]
    back = study.worlds_of(study.mu_of(worlds, application), application)
    for world, same in zip(worlds, back, strict=True):
        assert same.goal == world.goal
        assert same.parked == world.parked
        np.testing.assert_allclose(same.features, world.features, atol=1e-5)
    for world in study.worlds_of(rng.uniform(-1.0, 1.0, (50, 23)), application):
        assert searches.valid(world.features[None])[0]
        assert World.from_features(world.features) == world


def test_slots_are_counted_from_the_goal():
    assert slots_from(9)[:2] == [0, 1]
    assert slots_from(9)[9] == 19
    assert slots_from(12)[8] == 11
    assert all(sorted([*slots_from(goal), goal]) == list(range(20)) for goal in range(20))
    assert len(OTHERS) == 19


def test_the_car_drives_as_in_highway_env():
    theirs = ParkingEnv({"add_walls": False})
    theirs.reset(seed=0)
    start = theirs.vehicle
    world = World(3, 0.3, 1.0, -2.0, frozenset())
    ours = ParkingWorld()
    ours.reset(options=world.options)
    start.position, start.heading = np.array([1.0, -2.0]), 2.0 * np.pi * 0.3
    for action in np.random.default_rng(2).uniform(-1.0, 1.0, (20, 2)):
        expected, observed = theirs.step(action)[0], ours.step(action)[0]
        np.testing.assert_allclose(observed["observation"], expected["observation"])


def test_a_parked_car_ahead_is_a_crash_and_an_empty_place_is_late(application):
    free = World(15, 0.25, -2.0, 0.0, frozenset())  # it looks into slot 5
    taken = replace(free, parked=frozenset({5}))
    env, ends = ParkingWorld(), []
    for world in (free, taken):
        env.reset(options=world.options)
        steps, ended = 0, False
        while not ended:
            *_, terminated, truncated, info = env.step(straight_on(None))
            steps, ended = steps + 1, terminated or truncated
        ends.append((steps, info["crashed"]))
        assert not info["is_success"]
    assert ends[0] == (100, False)
    assert ends[1][0] < 30
    assert ends[1][1]
    fooled = application.evaluate(study.mu_of([free, taken], application), [0, 0]).fooled
    assert fooled.tolist() == [True, True]


def test_a_car_that_stands_in_its_slot_has_parked_unless_it_has_crashed():
    env = ParkingWorld()
    env.reset(seed=0)
    goal = env.observation_type.observe()["desired_goal"]
    assert env._is_success(goal, goal)
    rewards = env.compute_reward(np.array([goal, goal]), goal, [{"crashed": True}, {}])
    np.testing.assert_allclose(rewards, [-5.0, 0.0])
    env.vehicle.crashed = True
    assert not env._is_success(goal, goal)


def test_training_keeps_the_worlds_and_how_they_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "_BUFFER", 1_000)
    training.run(training.Recipe(steps=220, first_steps=216), 0, tmp_path)
    with np.load(tmp_path / "parking-log.npz") as kept:
        assert kept["features"].shape == (len(kept["failed"]), 24)
        assert searches.valid(kept["features"].astype(float)).all()
        assert (np.diff(kept["ended"]) <= 100).all()
    assert {path.name for path in tmp_path.iterdir()} == {"parking.zip", "parking-log.npz"}
    figures = training.measure(
        SAC.load(tmp_path / "parking.zip", env=ParkingWorld()), seed=0, episodes=2
    )
    assert figures.count("\n") == 5


def test_the_classifier_learns_which_slot_matters(log, monkeypatch):
    monkeypatch.setattr(searches, "_EPOCHS", 40)
    classifier = searches.Classifier(log, 0)
    free, taken = (np.array(log.features) for _ in range(2))
    free[:, 0], taken[:, 0] = 0.0, 1.0
    assert classifier(taken).mean() > classifier(free).mean() + 0.1
    assert classifier.gradient(free).mean(axis=0).argmax() == 0


@pytest.mark.parametrize("search", [searches.indago, searches.nexus])
def test_a_search_proposes_worlds_that_fail(search, log, monkeypatch):
    if search is searches.nexus:
        pytest.importorskip("pymoo")
    monkeypatch.setattr(searches, "GENERATIONS", 4)
    played = []

    def ask(features):
        assert searches.valid(features).all()
        played.extend(features)
        return features[:, 0] > 0.5

    search(ask, 7, log, 0)
    assert len(played) == 7
    assert np.mean([row[0] for row in played]) > 0.5


def test_a_front_s_knee_and_the_distance_to_an_archive(log):
    front = np.array([[0.0, 1.0], [0.1, 0.1], [1.0, 0.0]])
    assert searches.knee(front, 1).tolist() == [1]
    near = searches.distances(log.features, log.features[:3])
    np.testing.assert_allclose(near[:3], 0.0)
    assert near[3:].min() > 0.0
    assert searches.distances(log.features, log.features[:0]).min() > 0.0


def test_unique_failures_are_the_clusters_that_a_search_reaches():
    rng = np.random.default_rng(0)
    heaps = [centre + 0.01 * rng.normal(size=(6, 24)) for centre in (0.0, 5.0, 10.0)]
    found = study.unique_failures(
        {"one": heaps[0], "two": [*heaps[1], *heaps[2]], "none": []}, seed=0
    )
    assert found == {"one": 1, "two": 2, "none": 0}
    assert study.unique_failures({"none": []}, seed=0) == {"none": 0}
    assert study.unique_failures({"one": heaps[0][:1]}, seed=0) == {"one": 1}


def test_the_first_failure_is_counted_from_one():
    assert study.first_failure([0, 0, 1]) == 3
    assert study.first_failure([0, 0]) == 3


def test_a_run_spends_its_budget_and_gets_a_row(application, tmp_path, log, monkeypatch):
    monkeypatch.setattr(searches, "GENERATIONS", 1)
    monkeypatch.setattr(searches, "_EPOCHS", 1)
    monkeypatch.setattr(study, "SEEDS", (0, 1))
    np.savez(tmp_path / "log.npz", features=log.features, failed=log.failed)
    monkeypatch.setattr(study, "LOG", tmp_path / "log.npz")
    monkeypatch.setattr(study, "parking", partial(study.parking, straight_on))
    study.main(["--out", str(tmp_path), "--budget", "5", "--searches", "random", "INDAGO"])
    pieces = [json.loads(path.read_text()) for path in sorted(tmp_path.glob("*.json"))]
    assert len(pieces) == 4
    assert all(len(piece["failed"]) == piece["budget"] == 5 for piece in pieces)
    assert all(len(piece["failures"]) == sum(piece["failed"]) for piece in pieces)
    assert study.table(tmp_path).count("\n") == 3


def test_a_changed_agent_is_refused(tmp_path):
    (tmp_path / "agent.zip").write_bytes(b"another one")
    with pytest.raises(ValueError, match=r"Expected agent\.zip with SHA-256 0, got"):
        study.checked(tmp_path / "agent.zip", "0")
