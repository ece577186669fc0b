import random

import gymnasium as gym
import numpy as np
import pytest
import torch
from drivers import as_driver
from gymnasium import spaces
from gymnasium.wrappers.vector import TransformAction
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnvWrapper,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
)

import sada_gym  # noqa: F401 - registers
from sada_gym import agents
from sada_gym.agents.policy import POLICY_TILE
from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.episodes import (
    ACTION_SPACE,
    OBSERVATION_SPACE,
    DriveDistribution,
    DrivingEpisodes,
)
from sada_gym.envs.driving.task import DrivingTaskEnv
from sada_gym.foundations.sb3_vec_env import SB3VecEnv
from studies.training.driving.privileged import PrivilegedDriver

SMALL = {
    "policy_kwargs": {"net_arch": [8]},
    "n_steps": 8,
    "batch_size": 8,
    "seed": 0,
    "device": "cpu",
}


@pytest.fixture(scope="module")
def model():
    return new_model(0)


def cars(count, seed=0):
    rng = np.random.default_rng(seed)
    distribution = DriveDistribution(lateral_m=0.5, turned_deg=5.0, speed_m_s=8.0)
    return DrivingEpisodes(camera("training"), [distribution.draw(rng) for _ in range(count)])


class Recorder:
    """A model that keeps what it was shown."""

    def __init__(self, observation_space=OBSERVATION_SPACE, action=(0.0, 1.0)):
        self.observation_space, self.action_space = observation_space, ACTION_SPACE
        self.shown, self.action = [], action

    def predict(self, observation, *, deterministic):
        assert deterministic
        self.shown.append({key: value.copy() for key, value in observation.items()})
        return np.tile(np.array(self.action, np.float32), (POLICY_TILE, 1)), None


def recorded(recorder):
    """A driver, and what it is, which forgets what it was shown when the driver was made."""
    driver = as_driver(recorder)
    recorder.shown = []
    return driver, recorder


def test_an_action_does_not_depend_on_who_else_drives(model):
    drives = cars(40)
    driver = as_driver(model)
    driver.start(40)
    together = driver.act(drives, np.arange(40))
    shuffled = np.random.default_rng(1).permutation(40)
    np.testing.assert_array_equal(driver.act(drives, shuffled), together[shuffled])
    for i in (0, 7, 15, 16, 39):
        np.testing.assert_array_equal(driver.act(drives, np.array([i]))[0], together[i])


@pytest.mark.parametrize("widths", [[], [4], [8]])
def test_so_it_is_where_narrow_layers_give_other_bits_in_another_place(widths):
    model = PPO(
        "MultiInputPolicy", DrivingTaskEnv(), **{**SMALL, "policy_kwargs": {"net_arch": widths}}
    )
    drives, driver = cars(40), as_driver(model)
    driver.start(40)
    together = driver.act(drives, np.arange(40))
    shuffled = np.random.default_rng(1).permutation(40)
    np.testing.assert_array_equal(driver.act(drives, shuffled), together[shuffled])


def test_a_model_sees_full_tiles_only():
    driver, recorder = recorded(Recorder())
    driver.start(20)
    assert driver.act(cars(20), np.arange(20)).shape == (20, 2)
    assert [len(shown["image"]) for shown in recorder.shown] == [POLICY_TILE, POLICY_TILE]


def test_frames_are_stacked_as_in_training():
    stacked = VecFrameStack(DummyVecEnv([DrivingTaskEnv]), 3)
    driver, recorder = recorded(Recorder(stacked.observation_space))
    stacked.seed(4)
    seen = [stacked.reset()]
    rng = np.random.default_rng(4)
    env = DrivingTaskEnv()
    env.reset(seed=4)
    drives = env.task.episodes
    driver.start(1)
    for _ in range(4):
        action = np.array([[rng.uniform(-0.2, 0.2), 0.7]], np.float32)
        driver.act(drives, np.zeros(1, np.intp))
        drives.step(np.zeros(1, np.intp), action)
        seen.append(stacked.step(action)[0])
    assert len(recorder.shown) == 4
    for shown, theirs in zip(recorder.shown, seen[:-1], strict=True):
        for key in OBSERVATION_SPACE:
            np.testing.assert_array_equal(shown[key][0], theirs[key][0], err_msg=key)


def test_stacks_of_different_cars_stay_apart():
    three = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (44, 100, 9), np.uint8),
            "speed": spaces.Box(0, 1, (3,), np.float32),
            "command": spaces.Box(0, 1, (12,), np.float32),
        }
    )
    driver, recorder = recorded(Recorder(three))
    drives = cars(2)
    driver.start(2)
    driver.act(drives, np.array([0, 1]))
    driver.act(drives, np.array([1]))
    shown = recorder.shown[-1]["speed"][0]
    assert shown[0] == 0.0
    assert shown[1] == shown[2] == pytest.approx(drives.states[1, 3] / 15)


class Constant(PPO):
    """A model that keeps what its policy is shown."""

    def predict(self, observation, *args, **kwargs):
        self.shown = [*getattr(self, "shown", []), observation]
        return np.tile(np.array([0.1, 0.5], np.float32), (len(observation["speed"]), 1)), None


def normalised(env):
    return VecNormalize(env, norm_obs_keys=["speed"], norm_reward=False)


def stacked(env):
    return VecFrameStack(env, 3)


@pytest.mark.parametrize(
    "wrappers",
    [
        (VecMonitor, normalised),
        (VecTransposeImage, stacked, normalised),
        (normalised, VecTransposeImage, stacked),
        (stacked, normalised, VecTransposeImage),
    ],
    ids=lambda wrappers: "-".join(getattr(w, "__name__", "?") for w in wrappers),
)
def test_a_driver_sees_what_its_wrappers_showed_it_in_training(wrappers):
    env = DummyVecEnv([DrivingTaskEnv])
    for wrapper in wrappers:
        env = wrapper(env)
    model = Constant("MultiInputPolicy", env, **SMALL)
    env.reset()
    for _ in range(20):
        env.step(np.array([[0.0, 1.0]]))  # statistics to normalise with
    env = model.get_env()
    inner = env
    while inner is not None:  # they stay as they are, as they do in an agent that is frozen
        if isinstance(inner, VecNormalize):
            inner.training = False
        inner = getattr(inner, "venv", None)
    env.seed(4)
    theirs = [env.reset()]
    alone = DrivingTaskEnv()
    alone.reset(seed=4)
    drives, (driver, _) = alone.task.episodes, recorded(model)
    driver.start(1)
    for _ in range(5):
        action = driver.act(drives, np.zeros(1, np.intp))
        drives.step(np.zeros(1, np.intp), action)
        theirs.append({key: value.copy() for key, value in env.step(action)[0].items()})
    assert len(model.shown) == 5
    for shown, seen in zip(model.shown, theirs[:-1], strict=True):
        for key in OBSERVATION_SPACE:
            np.testing.assert_array_equal(shown[key][:1], seen[key], err_msg=key)


def test_the_statistics_of_training_are_part_of_a_drivers_fingerprint():
    env = normalised(DummyVecEnv([DrivingTaskEnv]))
    model = PPO("MultiInputPolicy", env, **SMALL)
    before = as_driver(model).fingerprint
    env.obs_rms["speed"].mean = env.obs_rms["speed"].mean + 1
    assert as_driver(model).fingerprint != before


def test_a_wrapper_that_is_not_known_is_refused():
    class Dark(VecEnvWrapper):
        def reset(self):
            return {key: 0 * value for key, value in self.venv.reset().items()}

        def step_wait(self):
            return self.venv.step_wait()

    model = PPO("MultiInputPolicy", Dark(DummyVecEnv([DrivingTaskEnv])), **SMALL)
    with pytest.raises(ValueError, match="got the wrapper Dark, whose work can't be repeated"):
        as_driver(model)


class DarkPicture(gym.ObservationWrapper):
    def observation(self, observation):
        return {**observation, "image": 0 * observation["image"]}


class OtherWay(gym.ActionWrapper):
    def action(self, action):
        return -action


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: DummyVecEnv([lambda: DarkPicture(DrivingTaskEnv())]), "ObservationWrapper"),
        (lambda: DummyVecEnv([lambda: OtherWay(DrivingTaskEnv())]), "ActionWrapper"),
        (
            lambda: SB3VecEnv(
                TransformAction(gym.make_vec("SADA-DrivingTask-v0", num_envs=1), lambda a: -a)
            ),
            "TransformAction",
        ),
    ],
    ids=["observations", "actions", "a batch's actions"],
)
def test_gymnasiums_wrappers_of_what_is_seen_or_done_are_refused(make, name):
    model = PPO("MultiInputPolicy", make(), **SMALL)
    with pytest.raises(ValueError, match=f"{name}, whose work can't be repeated"):
        as_driver(model)


def test_a_model_with_a_memory_is_refused():
    class Remembering(Recorder):
        def predict(self, observation, *, deterministic):
            return super().predict(observation, deterministic=deterministic)[0], np.zeros(1)

    with pytest.raises(ValueError, match="without a memory of its own, got Remembering"):
        as_driver(Remembering())


def test_a_driver_trained_on_another_picture_is_refused_by_what_it_was_trained_on():
    class Small(gym.ObservationWrapper):
        def __init__(self):
            super().__init__(DrivingTaskEnv())
            small = spaces.Box(0, 255, (40, 90, 3), np.uint8)
            self.observation_space = spaces.Dict({**self.env.observation_space, "image": small})

        def observation(self, observation):
            return {**observation, "image": observation["image"][:40, :90]}

    model = PPO("MultiInputPolicy", DummyVecEnv([Small]), **SMALL)
    with pytest.raises(ValueError, match=r"got observations Dict.*\(40, 90, 3\)"):
        as_driver(model)


def test_normalised_observations_without_their_statistics_are_refused(tmp_path):
    env = VecNormalize(DummyVecEnv([DrivingTaskEnv]), norm_obs_keys=["image"])
    PPO("MultiInputPolicy", env, **SMALL).save(tmp_path / "driver.zip")
    bare = PPO.load(tmp_path / "driver.zip", device="cpu")
    with pytest.raises(ValueError, match=r"statistics of the VecNormalize.*Load it as PPO.load"):
        as_driver(bare)


@pytest.mark.long
def test_a_plain_sb3_model_drives(tmp_path):
    model = PPO("MultiInputPolicy", DrivingTaskEnv(), **SMALL)
    model.save(tmp_path / "driver.zip")
    application = DrivingApplication("straight", agent=PPO.load(tmp_path / "driver.zip"))
    outcomes = application.evaluate([[0.0, 0.0, -1.0]], [0])
    assert 0.0 <= outcomes.score[0] <= 1.0
    assert application.agent_name == "PPO"
    assert len(application.fingerprint) == 64


def test_a_driver_of_another_task_is_named_with_both_spaces():
    other = Recorder(spaces.Box(0, 1, (7,), np.float32))
    with pytest.raises(ValueError, match=r"observations Dict\(.*got observations Box\(.*\(7,\)"):
        as_driver(other)
    other = Recorder()
    other.action_space = spaces.Discrete(3)
    with pytest.raises(ValueError, match=r"and actions Discrete\(3\). Train it on SADA-Driving"):
        as_driver(other)


@pytest.mark.parametrize("given", [np.nan, np.inf, -np.inf])
def test_no_finite_number_from_a_driver_names_step_and_route(given):
    application = DrivingApplication("one_curve", agent=Recorder(action=(given, 0.0)))
    with pytest.raises(ValueError, match=r"step 0 of the route A1 B1 B0\. Look for NaN"):
        application.evaluate([[0.0, 0.0, 0.0]], [0])


def test_nan_in_the_weights_of_a_real_policy_names_step_and_route():
    model = new_model(0)
    application = DrivingApplication("one_curve", agent=model)
    with torch.no_grad():  # only now: an application refuses such weights
        model.policy.action_net.weight[0, 0] = torch.nan
    with pytest.raises(ValueError, match=r"finite actions from PPO.*step 0 of the route A1 B1 B0"):
        application.evaluate([[0.0, 0.0, 0.0]], [0])


def test_actions_of_another_shape_are_refused():
    recorder = Recorder(action=(0.0, 0.0, 0.0))
    driver = as_driver(recorder)
    driver.start(1)
    with pytest.raises(
        ValueError, match=r"actions of shape \(16, 2\) from Recorder, got \(16, 3\)"
    ):
        driver.act(cars(1), np.array([0]))


def test_another_driver_has_another_fingerprint(model):
    assert as_driver(model).fingerprint == as_driver(new_model(0)).fingerprint
    assert as_driver(model).fingerprint != as_driver(new_model(1)).fingerprint
    assert as_driver(Recorder()).fingerprint is None
    own = Constant("MultiInputPolicy", DrivingTaskEnv(), **SMALL)
    assert as_driver(own).fingerprint is None  # its weights do not tell what its predict does


def test_each_command_has_a_head_of_its_own(model):
    extractor = model.policy.features_extractor
    seen = {
        "image": torch.zeros(4, 3, 44, 100),
        "speed": torch.zeros(4, 1),
        "command": torch.eye(4),
    }
    features = extractor(seen).reshape(4, 4, -1)
    for given in range(4):
        for branch in range(4):
            assert bool(features[given, branch].any()) == (given == branch)


def test_making_and_loading_a_driver_reseeds_nobodys_generators():
    before = np.random.get_state()[1].copy(), torch.get_rng_state(), random.getstate()  # noqa: NPY002
    agents.load("cil", "SADA-Driving")
    new_model(5)
    np.testing.assert_array_equal(np.random.get_state()[1], before[0])  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), before[1])
    assert random.getstate() == before[2]


def test_agents_of_two_applications_may_share_a_name():
    files = [agents.card("ppo", of).file for of in ("SADA-UAV", "SADA-Driving")]
    assert files == ["uav/agent/ppo.safetensors", "driving/agent/ppo.safetensors"]
    with pytest.raises(ValueError, match=r"an agent's name among photographer, .*, got 'ppo'"):
        agents.card("ppo", "SADA-Detection")


class Broken(PrivilegedDriver):
    def act(self, drives, which):
        return super().act(drives, which) * np.nan


class Narrow(PrivilegedDriver):
    def act(self, drives, which):
        return super().act(drives, which)[:, :1]


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (Broken(), r"finite actions, got \[nan, nan\] at step 0 of the route A1 B1 C1\. Look for"),
        (Narrow(), r"actions of shape \(5, 2\), one for each .*, got \(5, 1\)"),
    ],
)
def test_what_an_agent_of_ones_own_does_is_checked(agent, message):
    with pytest.raises(ValueError, match=message):
        DrivingApplication("straight", agent=agent).evaluate([[0.0, 0.0, -1.0]], [0])


def test_an_agent_of_ones_own_drives():
    application = DrivingApplication("straight", agent=PrivilegedDriver())
    assert application.evaluate([[0.0, 0.0, -1.0]], [0]).score[0] == 1.0
    assert application.fingerprint == PrivilegedDriver.fingerprint
    with pytest.raises(
        ValueError, match="Expected an SB3 model trained on SADA-DrivingTask-v0, or"
    ):
        DrivingApplication("straight", agent=None)
