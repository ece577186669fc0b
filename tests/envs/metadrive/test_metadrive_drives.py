"""MetaDrive as an application: scores, purity, its one engine, what it tells, agents, pictures."""

from __future__ import annotations

import pickle
import re
from contextlib import closing
from importlib.metadata import distribution

import gymnasium as gym
import numpy as np
import pytest
from killed_runs import check_same_bits
from zoo import needs

import sada_gym
from sada_gym import agents, attack
from sada_gym.envs.metadrive import close_engine
from sada_gym.envs.metadrive.application import MetaDriveApplication
from sada_gym.envs.metadrive.card import CARD
from sada_gym.envs.metadrive.episodes import STATES, UNFINISHED, DriveEpisodes
from sada_gym.envs.metadrive.start import NOMINAL, PARAMETERS, DriveStart
from sada_gym.errors import MissingPart, UserError
from sada_gym.testing.processes import in_fresh_process
from sada_gym.testing.purity import compare_outcomes
from sada_gym.testing.rules import check_outcomes

pytestmark = needs("metadrive-simulator")


@pytest.fixture(scope="module", autouse=True)
def leave_no_engine():
    """MetaDrive's own environments, in tests after these, cannot be made beside our engine."""
    yield
    close_engine()


D, ONE = len(PARAMETERS), np.array([0])
SCRIPT = """
import sys
from sada_gym import attack
from metadrive_agents import Swerver
from sada_gym.envs.metadrive.application import MetaDriveApplication

if __name__ == "__main__":
    attack(MetaDriveApplication(agent=Swerver()), "random", out=sys.argv[1], budget=8, samples=3,
           seed=0)
"""
SETTINGS = {"budget": 8, "samples": 3, "seed": 0}


class Straight:
    """Drives straight on, and notes what it saw."""

    fingerprint = "straight"

    def __init__(self, pedal=0.5):
        self.pedal, self.seen = pedal, []

    def start(self, count):
        self.seen = []

    def act(self, episodes, which):
        self.seen.append(episodes.observe(which))
        return np.array([[0.0, self.pedal]])


def swerving(**keywords):
    from metadrive_agents import Swerver

    return MetaDriveApplication(agent=Swerver(), **keywords)


def start_of(seed=0, scene=5_000, **changed):
    return DriveStart({**NOMINAL, **changed}, scene, seed)


def worlds(count):
    mu = np.random.default_rng(0).uniform(-1, 1, (count, D)).astype(np.float32)
    mu[:, :2] = 1.0  # much traffic, and accidents: most of what could be left over
    return mu, list(range(count))


def driven(start, steps, agent):
    episodes = DriveEpisodes([start])
    agent.start(1)
    for _ in range(steps):
        if len(episodes.under_way()):
            episodes.step(ONE, agent.act(episodes, ONE))
    return episodes


@pytest.mark.long
def test_a_world_is_the_same_whatever_came_before_and_in_a_fresh_process():
    application = swerving()
    mu, seeds = worlds(3)
    first = application.evaluate(mu, seeds)
    for rows in ([2, 0, 1], [1, 1]):
        again = application.evaluate(mu[rows], [seeds[i] for i in rows])
        compare_outcomes(first, again, "after others", rows)
    elsewhere = in_fresh_process(application.evaluate, mu[::-1], seeds[::-1], home=Straight)
    compare_outcomes(first, elsewhere, "in a fresh process", [2, 1, 0])


@pytest.mark.slow
def test_the_expert_scores_the_same_whatever_came_before():
    application = MetaDriveApplication()
    mu, seeds = worlds(6)
    first = application.evaluate(mu, seeds)
    rows = [4, 1, 5, 0, 3, 2]
    again = application.evaluate(mu[rows], [seeds[i] for i in rows])
    compare_outcomes(first, again, "after others", rows)
    elsewhere = in_fresh_process(application.evaluate, mu[::-1], seeds[::-1], home=Straight)
    compare_outcomes(first, elsewhere, "in a fresh process", [5, 4, 3, 2, 1, 0])


@pytest.mark.slow
def test_workers_and_a_killed_run_have_the_same_bits(tmp_path):
    def attack_in(folder, **options):
        return attack(swerving(), "random", out=folder, **options, **SETTINGS)

    check_same_bits(tmp_path, 11, SCRIPT, attack_in)


@pytest.mark.long
def test_what_an_evaluation_tells():
    application = swerving()
    check_outcomes(application)
    mu, seeds = worlds(1)
    (found,) = application.behaviours(mu, seeds)
    words = r"(left its road|hit a car|hit an object on the road) after \d\.\d s and \d+% of .*"
    assert re.fullmatch(words, found.text)
    assert len(found.events) == 1
    (info,) = application.evaluate(mu, seeds).infos
    assert info["score"] == pytest.approx(info["route_done"], abs=1e-4)
    assert info["fooled"]


def test_a_route_without_an_arrival_counts_at_most_so_much():
    episodes = DriveEpisodes([start_of()])
    episodes.done[0] = 0.98
    assert episodes.score[0] == UNFINISHED == MetaDriveApplication.fooling_threshold
    assert episodes.under_way().tolist() == [0]
    episodes.ending[0] = 1
    assert episodes.score[0] == 1.0


def test_mass_and_brakes_are_what_their_names_say():
    def stopping_m(**changed):
        episodes = driven(start_of(**changed), 25, Straight(1.0))
        begin = np.array(episodes.car.position)
        speed = episodes.car.speed
        agent = Straight(-0.2)
        while len(episodes.under_way()) and episodes.car.speed > 0.5:
            episodes.step(ONE, agent.act(episodes, ONE))
        return speed, float(np.linalg.norm(np.array(episodes.car.position) - begin))

    speed, way_m = stopping_m()
    heavy_speed, heavy_m = stopping_m(mass_kg=1600.0)
    assert heavy_speed < 0.8 * speed  # it was slower, and yet ...
    assert heavy_m / heavy_speed**2 > 1.3 * way_m / speed**2
    assert stopping_m(brake_force=80.0)[1] > 1.5 * way_m


def test_commands_come_late():
    def way_m(latency_s):
        episodes = driven(start_of(latency_s=latency_s), 8, Straight(1.0))
        return float(episodes.car.position[0]) - 5.0

    ways = [way_m(latency_s) for latency_s in (0.0, 0.05, 0.1, 0.4)]
    assert ways[0] > 1.1 * ways[1]
    assert ways[1] > 1.1 * ways[2]
    assert ways[2] > 2.0 * ways[3]


def test_the_lidar_loses_rays_and_is_noisy():
    busy = {"traffic_density": 0.2, "lanes": 3.0}

    def seen(**changed):
        agent = Straight()
        driven(start_of(**busy, **changed), 70, agent)
        return np.concatenate([one["lidar"] for one in agent.seen[1:]])

    clean, lost, noisy = seen(), seen(lidar_dropout=0.5), seen(lidar_noise_m=1.0)
    hits = clean < 1.0
    assert hits.sum() > 50
    assert 0.4 < (lost[hits] < 1.0).mean() < 0.6
    assert (lost[~hits] == 1.0).all()
    assert 0.5 < 50.0 * (noisy - clean)[hits].std() < 1.5
    assert (noisy[~hits] == 1.0).all()


@pytest.mark.parametrize("speed", [20.0, 50.0])
def test_other_drivers_want_what_they_are_told(speed):
    agent = Straight(-1.0)  # it stands: traffic drives when the car comes near
    conditions = {"traffic_density": 0.1, "traffic_spread_km_h": 0.0, "traffic_speed_km_h": speed}
    episodes = DriveEpisodes([start_of(**conditions, traffic_gap_s=0.7, cut_in_gap_m=4.0)])
    from metadrive.policy.idm_policy import IDMPolicy

    agent.start(1)
    policies = episodes.env.engine.get_policies().values()
    drivers = [policy for policy in policies if isinstance(policy, IDMPolicy)]
    assert drivers
    for driver in drivers:
        assert driver.NORMAL_SPEED == driver.target_speed == speed
        assert (driver.TIME_WANTED, driver.SAFE_LANE_CHANGE_DISTANCE) == (0.7, 4.0)
    assert IDMPolicy.NORMAL_SPEED == 30  # the package's own class stays


def test_roads_are_as_they_should_be():
    narrow = DriveEpisodes([start_of(lanes=2.0, lane_width_m=3.0, junctions=1.0)])
    network = narrow.env.current_map
    assert {block.ID for block in network.blocks[1:2]} <= set("XTO")
    assert network.config["lane_num"] == 2
    assert network.config["lane_width"] == 3.0
    tight = DriveEpisodes([start_of(curve_radius_m=25.0, junctions=0.0)])
    blocks = tight.env.current_map.blocks
    assert blocks[1].ID in "CSrR"
    assert blocks[-1].get_config()["radius"] == 25.0
    tight.snapshot()
    assert len(tight.starts[0].roads) > len(blocks)


def test_an_older_world_is_lost_and_says_so():
    older = DriveEpisodes([start_of()])
    DriveEpisodes([start_of()])
    with pytest.raises(UserError, match=r"one engine, got an older one\. Close"):
        older.step(ONE, np.zeros((1, 2)))


def test_one_drive_at_a_time():
    with pytest.raises(UserError, match=r"one engine a process, got 2\. Set num_envs=1"):
        DriveEpisodes([start_of(), start_of()])
    env = gym.make_vec("SADA-DrivingMetaDriveTask-v0", num_envs=2)
    with pytest.raises(UserError, match="one engine a process, got 2"):
        env.reset(seed=0)


@pytest.mark.long
def test_another_environment_in_this_process_is_told_by_what_fixes_it():
    from metadrive import MetaDriveEnv
    from metadrive.engine.base_engine import BaseEngine

    sada_gym.envs.metadrive.close_engine()
    pull, BaseEngine.try_pull_asset = BaseEngine.try_pull_asset, staticmethod(lambda: None)
    other = MetaDriveEnv({"use_render": False, "log_level": 50})
    try:
        other.reset()
        with pytest.raises(UserError, match=r"no other MetaDrive environment.*Call its close"):
            DriveEpisodes([start_of()])
    finally:
        BaseEngine.try_pull_asset = pull
        other.close()
    assert len(DriveEpisodes([start_of()]).under_way()) == 1


def test_nothing_is_downloaded_and_the_package_stays_as_it_is(monkeypatch):
    from metadrive.engine import base_engine

    def pull(**_):
        raise AssertionError("a download")

    monkeypatch.setattr(base_engine, "pull_asset", pull)
    before = base_engine.BaseEngine.try_pull_asset
    sada_gym.envs.metadrive.close_engine()
    DriveEpisodes([start_of()])
    assert base_engine.BaseEngine.try_pull_asset is before
    assert not distribution("metadrive-simulator").locate_file("metadrive/assets").exists()


def test_the_expert_acts_as_its_package_says():
    from metadrive.examples import expert as original

    episodes = DriveEpisodes([start_of(seed=1)])
    expert = agents.load("metadrive-expert", "SADA-DrivingMetaDrive")
    for _ in range(20):
        action = expert.act(episodes, ONE)
        theirs = original(episodes.car, deterministic=True)
        np.testing.assert_allclose(action[0], theirs, atol=1e-4)
        episodes.step(ONE, action)


@pytest.mark.parametrize("name", ["metadrive-expert", "metadrive-idm", "metadrive-ppo"])
def test_named_drivers_drive_and_can_be_sent_to_workers(name):
    application = MetaDriveApplication(agent=name)
    assert re.fullmatch("[0-9a-f]{64}", application.fingerprint)
    episodes = driven(start_of(), 60, application.policy)
    assert episodes.done[0] > 0.1
    copy = pickle.loads(pickle.dumps(application))
    assert copy.fingerprint == application.fingerprint


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": "9.9"}, r"metadrive-simulator 9.9, got 0.4.3.*\[zoo\]"),
        ({"members": {"metadrive/policy/idm_policy.py": "0" * 64}}, "SHA-256 000000000000..., got"),
        ({"members": {"metadrive/gone.npz": "0" * 64}}, "got no such fil"),
    ],
)
def test_a_package_that_is_another_is_refused(monkeypatch, change, message):
    from dataclasses import replace

    from sada_gym.agents.packaged import package_files

    with pytest.raises(MissingPart, match=message):
        package_files(replace(CARD.packaged[0], **change))


@pytest.mark.parametrize("found", ["", "0.4.2"])
def test_without_its_package_every_id_says_what_installs_it(monkeypatch, found):
    from sada_gym.agents import packaged

    sada_gym.envs.metadrive.close_engine()
    monkeypatch.setattr(packaged, "_version", lambda _: found)
    expected = f"metadrive-simulator 0.4.3, got {found or 'none'}.*zoo.*Python below 3.12"
    with pytest.raises(MissingPart, match=expected):
        gym.make("SADA-DrivingMetaDrive-v0")
    with pytest.raises(MissingPart, match=expected):
        gym.make("SADA-DrivingMetaDriveTask-v0").reset(seed=0)


def test_a_careful_driver_brakes_for_a_stopped_car_as_the_regulation_says():
    from sada_gym.envs.metadrive.agent.idm import CarefulDriver

    driver = CarefulDriver()
    episodes = DriveEpisodes([start_of()])
    driver.start(1)
    times = iter([9.0, *[1.5] * 30])
    braking = []
    import sada_gym.envs.metadrive.agent.idm as module

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_time_to_collision", lambda *_: next(times))
        for _ in range(25):
            action = driver.act(episodes, ONE)
            braking.append(action[0, 1] < 0)
            episodes.step(ONE, action)
    assert braking.index(True) == 12  # the first step is no risk; 0.4 s and 0.75 s from the next
    full = 0.774 * 9.81 * 1100 / (200 * 150)
    assert action[0, 1] == pytest.approx(-full)


def test_accidents_happen_after_a_first_world_without_any():
    close_engine()
    application = swerving()
    mu = np.tile(application.nominal, (2, 1))
    mu[1, PARAMETERS.names.index("accident_prob")] = 1.0
    things = []
    for row in mu:
        with closing(application.episodes(row[None], [0])) as drive:
            things.append(len(drive._engine.env.engine.managers["object_manager"].spawned_objects))
    assert things[0] == 0 < things[1]


@pytest.mark.long
def test_frames_show_the_road():
    application = swerving()
    mu, seeds = worlds(2)
    frame, other = application.render_batch(mu, seeds)  # one after the other
    assert frame.shape[1] == other.shape[1] == 700
    assert (application.render(mu[1], seeds[1]) == other).all()
    seen = application.observation(mu[0], seeds[0])
    assert seen.shape == (460, 700, 3)
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 20
    frames, score = application.replay(mu[0], seeds[0])
    assert score == application.evaluate(mu, seeds).score[0]
    assert len(frames) > 10


@pytest.mark.long
def test_the_inner_task_passes_both_checkers_and_ends():
    from gymnasium.utils.env_checker import check_env
    from stable_baselines3.common.env_checker import check_env as check_env_sb3

    env = gym.make("SADA-DrivingMetaDriveTask-v0", render_mode="rgb_array")
    check_env_sb3(env.unwrapped)
    check_env(env.unwrapped)
    observation, _ = env.reset(seed=3)
    assert observation["state"].shape == (STATES,)
    for _ in range(60):
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 1.0], np.float32))
        if terminated or truncated:
            break
    assert terminated
    assert reward == -5.0
    assert info["is_success"] is False
    env.close()
