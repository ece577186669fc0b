"""Tests of disturbed sensors and actuators."""

from __future__ import annotations

from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from scipy import stats
from wrapped_toys import cart_pole, pendulum, reach

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)

TWO = spaces.Box(-1.0, 1.0, (2,), np.float64)


class Clock(gym.Env):
    """It shows the time, and remembers what was done."""

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, action_space=TWO, high=1000.0, dtype=np.float64):
        self.action_space = action_space
        self.observation_space = spaces.Box(0.0, high, (2,), dtype)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.done = 0, []
        return self.look(), {}

    def look(self):
        return np.full(2, self.time, self.observation_space.dtype)

    def step(self, action):
        self.time += 1
        self.done.append(action)
        return self.look(), 0.0, False, False, {}


class Timed:
    """Its action is the time that it sees, as a share of 100, and it remembers what it saw."""

    def __init__(self, act):
        self.act, self.seen = act, []

    def __call__(self, observation):
        self.seen.append(observation)
        return self.act(observation)


def run(disturbance, *, at=1.0, steps=8, act=lambda seen: seen / 100.0, seed=0, **kwargs):
    """What an agent sees and what the environment gets, in one episode with one disturbance."""
    agent = Timed(act)
    application = GymnasiumApplication(
        Clock,
        agent=agent,
        parameters={"it": disturbance},
        score=("length", steps),
        fooling_threshold=0.5,
        max_steps=steps,
        env_kwargs=kwargs,
    )
    episodes = application.episodes(np.array([[at]], np.float32), [seed])
    application.play(episodes)
    return np.array(agent.seen), np.array(episodes.running[0].env.unwrapped.done)


def test_disturbances_are_wrappers_of_one_episode_from_the_actuators_to_the_agent():
    application = pendulum(
        parameters={
            "repeated": RepeatedActions(1, 3),
            "lost": ObservationDropout(0.0, 0.5),
            "late": ObservationDelay(0, 3),
            "noise": ObservationNoise(0.0, 0.1),
            "slow": ActionDelay(0, 3),
            "gain": ActionGain(0.5, 1.5),
            "shaky": ActionNoise(0.0, 0.3),
        },
        episodes=2,
    )
    first, second = application.episodes(np.zeros((1, 7), np.float32), [0]).running
    layers = []
    env = first.env
    while isinstance(env, gym.Wrapper):
        layers.append(type(env).__name__)
        env = env.env
    assert layers[:7] == [
        "_RepeatedSteps",
        "_LostObservations",
        "_LateObservations",
        "_NoisyObservations",
        "_LateActions",
        "_ScaledActions",
        "_NoisyActions",
    ]
    assert first.env is not second.env
    assert first.env.unwrapped is not second.env.unwrapped


def test_a_delay_repeats_the_first_observation():
    seen, _ = run(ObservationDelay(0, 3))
    assert seen[:, 0].tolist() == [0, 0, 0, 0, 1, 2, 3, 4]
    seen, _ = run(ObservationDelay(0, 3), at=-1.0)
    assert seen[:, 0].tolist() == [*range(8)]


def test_dropout_keeps_the_last_observation():
    seen, _ = run(ObservationDropout(0.0, 0.5), steps=400)
    kept = np.diff(seen[:, 0]) == 0
    assert seen[0, 0] == 0
    assert 0.4 < kept.mean() < 0.6
    fresh = np.flatnonzero(~kept) + 1
    assert (seen[fresh, 0] == fresh).all()
    seen, _ = run(ObservationDropout(0.5, 1.0))
    assert (seen == 0).all()


def test_noise_has_its_standard_deviation_and_stays_in_the_space():
    seen, _ = run(ObservationNoise(0.0, 2.0), steps=900)
    noise = (seen - np.arange(900)[:, None])[20:]
    assert noise.std() == pytest.approx(2.0, rel=0.1)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.1
    assert seen.min() == 0.0
    clean, _ = run(ObservationNoise(0.0, 2.0), at=-1.0)
    assert (clean == np.arange(8)[:, None]).all()


def test_noise_does_not_clip_what_the_environment_says():
    seen, _ = run(ObservationNoise(0.0, 1e-9), steps=8, high=3.0)
    assert np.allclose(seen, np.arange(8)[:, None], atol=1e-6)


def test_noise_on_some_entries_leaves_the_others():
    seen, _ = run(ObservationNoise(0.0, 2.0, entries=(1,)))
    assert (seen[:, 0] == np.arange(8)).all()
    assert (seen[1:, 1] != np.arange(1, 8)).all()


def test_noise_on_whole_numbers_is_rounded():
    seen, _ = run(ObservationNoise(0.0, 20.0), high=255, dtype=np.uint8, act=lambda seen: [0, 0])
    assert seen.dtype == np.uint8
    assert seen.max() <= 255
    assert (seen != np.arange(8)[:, None]).any()


PICTURE = spaces.Box(0, 255, (200, 300, 3), np.uint8)


class Grey(gym.Env):
    observation_space, action_space = PICTURE, spaces.Discrete(2)

    def __init__(self, shade):
        self.seen = np.full(PICTURE.shape, shade, np.uint8)

    def reset(self, *, seed=None, options=None):
        return self.seen, {}


def noisy_picture(shade, deviation, seed=0):
    env = ObservationNoise(0.0, 255.0).wrap(Grey(shade), deviation, np.random.default_rng(seed))
    return env.reset()[0], env.reset()[0]


@pytest.mark.parametrize(
    ("shade", "deviation"), [(100, 0.3), (100, 1.0), (100, 10.0), (0, 30.0), (250, 60.0), (7, 1e5)]
)
def test_noise_on_pictures_is_gaussian_rounded_and_clipped(shade, deviation):
    first, second = noisy_picture(shade, deviation)
    assert first.dtype == np.uint8
    assert first.shape == PICTURE.shape
    assert (first != second).any()
    bounds = stats.norm.cdf((np.arange(255) + 0.5 - shade) / deviation)
    expected = first.size * np.diff([0.0, *bounds, 1.0])
    counts = np.bincount(first.ravel(), minlength=256)
    often = expected > 5
    distance = ((counts - expected)[often] ** 2 / expected[often]).sum()
    assert distance < stats.chi2.ppf(1 - 1e-6, often.sum())
    assert counts[~often].sum() <= 5 + 3 * expected[~often].sum()


def test_neighbouring_pixels_have_independent_noise():
    noise = noisy_picture(128, 20.0)[0].astype(float).ravel() - 128.0
    for lag in (1, 2, 3, 4, 5, 900):
        assert abs(np.corrcoef(noise[lag:], noise[:-lag])[0, 1]) < 5 / noise.size**0.5


def test_noise_on_pictures_follows_from_the_seed_and_none_changes_nothing():
    first, again, other = (noisy_picture(9, 4.0, seed)[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    np.testing.assert_array_equal(noisy_picture(9, 0.0)[0], 9)


def test_actions_are_late_and_zeros_come_first():
    _, done = run(ActionDelay(0, 3))
    assert np.allclose(done[:, 0], [0, 0, 0, 0, 0.01, 0.02, 0.03, 0.04])
    away = spaces.Box(0.5, 1.0, (2,), np.float64)
    _, done = run(ActionDelay(0, 3), action_space=away, act=lambda seen: np.ones(2))
    assert done[:, 0].tolist() == [0.5, 0.5, 0.5, 1, 1, 1, 1, 1]


def test_the_first_of_choices_acts_until_it_arrives():
    _, done = run(ActionDelay(0, 3), action_space=spaces.Discrete(9), act=lambda seen: int(seen[0]))
    assert done.tolist() == [0, 0, 0, 0, 1, 2, 3, 4]
    _, done = run(
        ActionDelay(0, 2), action_space=spaces.Discrete(9), act=lambda seen: 5 + int(seen[0] > 0)
    )
    assert done.tolist() == [5, 5, 5, 6, 6, 6, 6, 6]


def test_gain_multiplies_and_clips():
    _, done = run(ActionGain(0.0, 2.0), act=lambda seen: np.array([0.25, -0.75]))
    assert (done == [0.5, -1.0]).all()


def test_action_noise_is_a_share_of_half_the_range():
    space = spaces.Box(-10.0, 30.0, (2,), np.float64)
    _, done = run(ActionNoise(0.0, 0.1), steps=900, action_space=space, act=lambda seen: [5, 5])
    assert done.std() == pytest.approx(2.0, rel=0.1)
    assert done.mean() == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize(
    ("space", "action", "spread"),
    [
        (spaces.Discrete(3, start=4), 4, 2),
        (spaces.MultiDiscrete([3, 5]), [0, 0], [2, 4]),
        (spaces.MultiBinary(4), [0, 0, 0, 0], [1, 1, 1, 1]),
    ],
)
def test_noise_on_choices_draws_other_ones(space, action, spread):
    _, done = run(ActionNoise(0.0, 1.0), steps=300, action_space=space, act=lambda seen: action)
    assert all(space.contains(observation) for observation in done.astype(space.dtype))
    assert np.array_equal(np.ptp(done, axis=0), spread)
    changed = (done != action).reshape(300, -1).any(axis=1).mean()
    assert changed > 0.6
    _, done = run(ActionNoise(0.0, 1.0), at=-1.0, action_space=space, act=lambda seen: action)
    assert (done == action).all()


def test_repeated_actions_are_asked_for_less_often():
    seen, done = run(RepeatedActions(1, 3), steps=8)
    assert seen[:, 0].tolist() == [0, 3, 6]
    assert np.allclose(done[:, 0], [0, 0, 0, 0.03, 0.03, 0.03, 0.06, 0.06])


def test_the_seed_fixes_noise_and_another_seed_has_other_noise():
    first, again, other = (run(ObservationNoise(0.0, 2.0), seed=seed)[0] for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first[1:] != other[1:]).all()


def test_episodes_of_one_evaluation_differ():
    application = cart_pole(episodes=2)
    episodes = application.episodes(np.zeros((1, 2), np.float32), [0])
    assert (episodes.observation(0) != episodes.observation(1)).all()


@pytest.mark.parametrize(
    ("make", "disturbance", "message"),
    [
        (cart_pole, ActionGain(0.5, 2.0), "actions that are numbers .* for the gain 'it'"),
        (cart_pole, ActionNoise(0.0, 2.0), "'it' of at most 1"),
        (cart_pole, ActionNoise(-1.0, 1.0), "ActionNoise 'it' of at least 0"),
        (cart_pole, ObservationNoise(-1.0, 1.0), "of at least 0"),
        (cart_pole, ObservationNoise(0.0, 1.0, key="angle"), "no key of 'it'"),
        (cart_pole, ObservationNoise(0.0, 1.0, entries=(4,)), "entries of 'it' of at most 3"),
        (cart_pole, ObservationDropout(0.0, 1.5), "of at least 0 and at most 1"),
        (cart_pole, ObservationDelay(0.5, 2.0), "whole numbers"),
        (cart_pole, ObservationDelay(-1, 2), "of at least 0"),
        (cart_pole, RepeatedActions(0, 2), "of at least 1"),
        (cart_pole, ObservationNoise(choices=("a", "b")), "of at least 0"),
        (reach, ObservationNoise(0.0, 1.0, key="goal"), r"observations of numbers \(Box\)"),
        (reach, ObservationNoise(0.0, 1.0, key="gaol"), "Did you mean goal"),
    ],
)
def test_what_does_not_fit_is_refused(make, disturbance, message):
    with pytest.raises(ValueError, match=message):
        make(parameters={"it": disturbance})


def test_noise_on_actions_without_bounds_is_refused():
    space = spaces.Box(-np.inf, np.inf, (2,))
    with pytest.raises(ValueError, match="finite bounds of the actions of Clock"):
        run(ActionNoise(0.0, 0.1), action_space=space)


def test_two_of_a_kind_are_refused():
    with pytest.raises(ValueError, match="one ObservationDelay, got 'a' and 'b'"):
        pendulum(parameters={"a": ObservationDelay(0, 1), "b": ObservationDelay(0, 2)})
    parts = {str(i): ObservationNoise(0.0, 1.0, entries=[i]) for i in range(3)}
    assert len(pendulum(parameters=parts).parameters) == 3
