"""What happens in an episode for a while: events, failing sensors and actuators, slow agents."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from wrapped_toys import balance, cart_pole, pendulum, set_length, swing

from sada_gym import GymnasiumApplication, StressEnv
from sada_gym.envs.images.conditions import CONDITIONS, developed
from sada_gym.envs.wrapped import (
    ActuatorFailure,
    CameraFault,
    Event,
    Force,
    ObservationBias,
    ObservationDrift,
    Push,
    RealTime,
    SensorFailure,
)
from sada_gym.envs.wrapped.kept import KeptEnvironments
from sada_gym.envs.wrapped.toml import binding_of
from sada_gym.errors import Notice, UserError


def lengthen(env, value):
    before = env.length
    env.length = 2.0 if value is True else value
    return lambda: set_length(env, before)


class Counting(gym.Env):
    """Observes the number of the step, thrice; the reward is the action's first entry."""

    observation_space = gym.spaces.Box(-100.0, 100.0, (3,), np.float64)
    action_space = gym.spaces.Box(-9.0, 9.0, (2,), np.float64)

    def __init__(self) -> None:
        self.length = 1.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.actions, self.lengths = 0, [], []
        return np.zeros(3), {}

    def step(self, action):
        self.time += 1
        self.actions.append(np.copy(action))
        self.lengths.append(self.length)
        return np.full(3, float(self.time)), float(np.ravel(action)[0]), self.time >= 8, False, {}


class Choosing(Counting):
    """Takes one of three actions."""

    action_space = gym.spaces.Discrete(3)


def counting(environment=Counting, **parameters):
    return GymnasiumApplication(
        environment,
        agent=lambda seen: np.array([seen[0] + 1.0, 1.0]) if environment is Counting else 1,
        agent_id="counting",
        parameters=parameters,
        score=("return", 0.0, 36.0),
        fooling_threshold=0.5,
        max_steps=8,
    )


def played(application, mu, act=lambda step: np.array([step + 1.0, 1.0])):
    """What the agent sees, (9, 3), and the environment after the episode."""
    (episode,) = application.episodes(np.array([mu], np.float32), [0]).running
    seen, steps = [episode.observation], 0
    while not episode.ended:
        episode.step(act(steps))
        seen.append(episode.observation)
        steps += 1
    return np.array(seen), episode.environment.unwrapped


def at(first, count, *others):
    """Mu of an event from `first` of (0, 7) on, for `count` of (0, 8) steps."""
    return [*others, 2 * (first + 0.5) / 8 - 1, 2 * (count + 0.5) / 9 - 1]


TIMES = {"at": (0, 7), "lasts": (0, 8)}


def test_an_event_begins_and_ends():
    application = counting(long=Event(set=lengthen, **TIMES))
    assert application.parameters.names == ("long_at", "long_lasts")
    assert [p.unit for p in application.parameters.parameters] == ["steps", "steps"]
    _, world = played(application, at(2, 3))
    assert world.lengths == [1, 1, 2, 2, 2, 1, 1, 1]
    _, world = played(application, at(6, 8))
    assert world.lengths == [1] * 6 + [2, 2]
    _, world = played(application, at(2, 0))
    assert world.lengths == [1] * 8
    assert application.evaluate([at(2, 3)], [0]).infos[0]["values"] == {
        "long_at": 2,
        "long_lasts": 3,
    }
    strong = counting(long=Event(0.0, 10.0, set=lengthen, at=1, lasts=(0, 8)))
    assert strong.parameters.names == ("long", "long_lasts")
    _, world = played(strong, [0.0, at(0, 2)[1]])
    assert world.lengths == [1, 5, 5, 1, 1, 1, 1, 1]


def heavier(env, value):
    before, env.length = env.length, env.length + 4.0

    def undo():
        env.length = before

    return undo


def test_events_overlap():
    application = counting(
        one=Event(set=lengthen, at=2, lasts=4),
        other=Event(set=heavier, at=4, lasts=3),
        third=Event(set=heavier, at=1, lasts=(2, 3)),
    )
    _, world = played(application, [1.0])
    assert world.lengths == [1, 5, 2, 2, 6, 6, 5, 1]


def test_an_event_ends_with_its_episode_where_the_environment_is_kept():
    application = counting(long=Event(set=lengthen, **TIMES))
    application.episode_spec = replace(
        application.episode_spec, kept=KeptEnvironments(application.episode_spec.factory, ())
    )
    for _ in range(2):
        with closing(application.episodes(np.array([at(6, 8)], np.float32), [0])) as episodes:
            (episode,) = episodes.running
            while not episode.ended:
                episode.step(np.ones(2))
            assert episode.environment.unwrapped.lengths == [1] * 6 + [2, 2]


def test_what_begins_an_event_returns_what_ends_it():
    application = counting(long=Event(set=lambda env, value: 5, **TIMES))
    with pytest.raises(UserError, match="to return a function that ends the event, or nothing"):
        application.evaluate([at(2, 3)], [0])


def test_a_force_may_have_its_time_as_a_parameter():
    pushes = []

    def apply(env, strength):
        pushes.append((env.time, strength))

    application = counting(push=Force(0.0, 1.0, apply=apply, at=(0, 7), steps=2))
    assert application.parameters.names == ("push", "push_at")
    pushes.clear()
    played(application, [1.0, at(3, 0)[0]])
    assert pushes == [(3, 1.0), (4, 1.0)]
    curved = counting(push=Force(0.0, 1.0, apply=apply, **TIMES, knots=2))
    assert curved.parameters.names == ("push[0]", "push[1]", "push_at", "push_lasts")
    pushes.clear()
    played(curved, at(1, 8, -1.0, 1.0))
    assert [time for time, _ in pushes] == [2, 3, 4, 5, 6, 7]
    assert [strength for _, strength in pushes] == pytest.approx(np.arange(1, 7) / 7)
    assert application.nominal.tolist() == [-1.0, 2 * 3.5 / 8 - 1]


@pytest.mark.parametrize("first", [0, 3, 7])
def test_a_push_begins_at_its_step(first):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    application = GymnasiumApplication(
        "InvertedPendulum-v5",
        agent=lambda seen: np.array([10.0 * seen[1] + 2.0 * seen[3]]),
        parameters={"push": Push(0.0, 30.0, at=(0, 7), lasts=(1, 5))},
        score=("length", 10),
        fooling_threshold=0.5,
        max_steps=10,
    )
    when = 2 * (first + 0.5) / 8 - 1
    still, pushed = (
        played(application, [strength, when, 0.0], act=lambda step: np.zeros(1))[0]
        for strength in (-1.0, 1.0)
    )
    both = zip(still, pushed, strict=False)
    differ = [not np.array_equal(one, other) for one, other in both]
    assert differ.index(True) == first + 1


@pytest.mark.parametrize(
    ("mode", "expected"), [("frozen", [2.0, 2.0, 2.0]), ("zero", [0.0, 0.0, 0.0])]
)
def test_sensors_fail(mode, expected):
    application = counting(blind=SensorFailure(entries=(1,), mode=mode, **TIMES))
    seen, world = played(application, at(3, 3))
    assert seen[3:6, 1].tolist() == expected
    assert seen[:, 0].tolist() == [*range(9)]
    assert seen[[0, 1, 2, 6, 7, 8], 1].tolist() == [0, 1, 2, 6, 7, 8]
    seen, _ = played(application, at(0, 8))
    assert seen[:8, 1].tolist() == [0.0] * 8
    assert world.time == 8


def test_sensors_give_noise():
    noisy = SensorFailure(0.0, 2.0, entries=(1,), mode="noise", **TIMES)
    application = counting(blind=noisy)
    assert application.parameters.names == ("blind", "blind_at", "blind_lasts")
    seen, _ = played(application, at(2, 6, 1.0))
    assert len(set(seen[2:8, 1].tolist())) == 6
    assert abs(seen[2:8, 1].mean()) < 2.5
    assert seen[8].tolist() == [8.0] * 3


class Watching(Counting):
    """Observes small pictures."""

    observation_space = gym.spaces.Box(0, 255, (3, 3, 1), np.uint8)

    def reset(self, **kwargs):
        return np.zeros((3, 3, 1), np.uint8), super().reset(**kwargs)[1]

    def step(self, action):
        return np.full((3, 3, 1), 9, np.uint8), *super().step(action)[1:]


def test_noise_in_the_place_of_a_picture_stays_in_its_range():
    application = counting(
        Watching, blind=SensorFailure(0.0, 9.0, entries=(0, 1, 2), mode="noise", **TIMES)
    )
    seen, _ = played(application, at(1, 8, 1.0))
    assert 0 < seen[1:, 0].max() < 60  # a negative number does not become a bright pixel


@pytest.mark.parametrize(
    ("mode", "entries", "expected"),
    [
        ("frozen", None, [[3.0, 1.0]] * 2),
        ("zero", None, [[0.0, 0.0]] * 2),
        ("zero", (1,), [[4.0, 0.0], [5.0, 0.0]]),
    ],
)
def test_actuators_fail(mode, entries, expected):
    application = counting(loose=ActuatorFailure(entries=entries, mode=mode, **TIMES))
    actions = np.array(played(application, at(3, 2))[1].actions)
    assert actions[3:5].tolist() == expected
    assert actions[[0, 1, 2, 5, 6, 7], 0].tolist() == [1, 2, 3, 6, 7, 8]
    first = np.array(played(application, at(0, 1))[1].actions)[0]
    assert first.tolist() == ([1.0, 0.0] if entries else [0.0, 0.0])


def test_actuators_of_choices_fail():
    frozen = counting(Choosing, loose=ActuatorFailure(**TIMES))
    _, world = played(frozen, at(2, 3), act=lambda step: step % 3)
    assert np.ravel(world.actions).tolist() == [0, 1, 1, 1, 1, 2, 0, 1]
    noisy = counting(Choosing, loose=ActuatorFailure(mode="noise", **TIMES))
    _, world = played(noisy, at(0, 8), act=lambda step: 0)
    assert len(set(np.ravel(world.actions).tolist())) > 1
    drawn = counting(loose=ActuatorFailure(mode="noise", **TIMES))
    actions = np.array(played(drawn, at(0, 8))[1].actions)
    assert np.unique(actions).size == 16
    assert (np.abs(actions) <= 9.0).all()


def test_sensors_are_off():
    biased = counting(bias=ObservationBias(-4.0, 4.0, entries=(0, 2)))
    seen, _ = played(biased, [0.5])
    assert (seen - np.arange(9)[:, None]).tolist() == [[2.0, 0.0, 2.0]] * 9
    drifting = counting(drift=ObservationDrift(-1.0, 1.0, entries=(0,)))
    seen, _ = played(drifting, [0.5])
    assert seen[:, 0].tolist() == (1.5 * np.arange(9)).tolist()
    assert drifting.nominal.tolist() == [0.0]
    seen, _ = played(counting(bias=ObservationBias(0.0, 500.0)), [1.0])
    assert seen.max() == 100.0


def test_worlds_stay_pure_and_their_nominal_one_is_undisturbed():
    application = pendulum(
        parameters={
            "blind": SensorFailure(at=(0, 40), lasts=(0, 20), entries=(2,)),
            "noise": SensorFailure(0.0, 2.0, at=(0, 40), lasts=(0, 20), mode="noise"),
            "loose": ActuatorFailure(at=(0, 40), lasts=(0, 20), mode="noise"),
            "bias": ObservationBias(-0.5, 0.5),
            "drift": ObservationDrift(-0.01, 0.01),
        },
        score=("return", -600.0, 0.0),
    )
    mu = np.random.default_rng(0).uniform(-1, 1, (6, len(application.parameters)))
    together = application.evaluate(mu, [*range(6)]).score.tolist()
    alone = [application.evaluate(mu[i : i + 1], [i]).score[0] for i in range(6)]
    assert together == alone
    assert len(set(together)) == 6
    plain = pendulum(parameters={"g": (5.0, 15.0)}, score=("return", -600.0, 0.0), agent=swing)
    nominal = application.evaluate([application.nominal], [5]).score
    assert nominal == plain.evaluate([[0.0]], [5]).score


class Camera(gym.Env):
    """A still picture."""

    action_space = gym.spaces.Discrete(2)

    def __init__(self, form="colour") -> None:
        self.form = form
        shape = {"colour": (24, 32, 3), "grey": (24, 32), "first": (3, 24, 32)}.get(form)
        box = gym.spaces.Box(0, 255, shape or (24, 32, 1), np.uint8)
        self.observation_space = gym.spaces.Dict({"eye": box}) if form == "dict" else box

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time = 0
        box = self.observation_space["eye"] if self.form == "dict" else self.observation_space
        self.picture = self.np_random.integers(0, 256, box.shape).astype(np.uint8)
        return self.look(), {}

    def look(self):
        return {"eye": self.picture} if self.form == "dict" else self.picture

    def step(self, action):
        self.time += 1
        return self.look(), 0.0, self.time >= 6, False, {}


def camera(form="colour", **parameters):
    return GymnasiumApplication(
        Camera,
        agent=lambda seen: 0,
        agent_id="still",
        env_kwargs={"form": form},
        parameters=parameters,
        score=("length", 6),
        fooling_threshold=0.5,
        max_steps=6,
    )


def pictures(application, mu):
    (episode,) = application.episodes(np.array([mu], np.float32), [0]).running
    seen = [episode.observation]
    while not episode.ended:
        episode.step(0)
        seen.append(episode.observation)
    return [one["eye"] if isinstance(one, dict) else one for one in seen]


@pytest.mark.parametrize("form", ["colour", "grey", "first", "one", "dict"])
def test_a_cameras_lens_is_out_of_focus_for_a_while(form):
    application = camera(form, lens=CameraFault(0.0, 0.1, at=(0, 5), lasts=(0, 6)))
    assert application.parameters.names == ("lens", "lens_at", "lens_lasts")
    seen = pictures(application, [1.0, 2 * 2.5 / 6 - 1, 2 * 3.5 / 7 - 1])
    assert all(one.shape == seen[0].shape for one in seen)
    assert all(one.dtype == np.uint8 for one in seen)
    changed = [not np.array_equal(one, seen[0]) for one in seen]
    assert changed == [False, False, True, True, True, False, False]
    if form == "colour":
        expected = developed(seen[0], (CONDITIONS["defocus"],), ((0.1,),), (0,)).image
        assert np.array_equal(seen[3], expected)


def test_a_cameras_fault_may_be_a_curve():
    exposure = CameraFault(condition="exposure", knots=2)
    application = camera(light=exposure)
    assert application.parameters.names == ("light[0]", "light[1]")
    assert [*application.curves] == ["light"]
    means = [one.mean() for one in pictures(application, [-1.0, 1.0])]
    assert means == sorted(means)
    assert means[0] < 60.0
    assert means[-1] > 200.0
    (seen,) = {one.tobytes() for one in pictures(application, [0.0, 0.0])}  # nominal: unchanged
    assert seen == pictures(camera(light=exposure), application.nominal)[0].tobytes()
    world = application.parameters.describe([-1.0, 1.0])
    assert world == {"light[0]": -3.0, "light[1]": 3.0}


def test_a_curve_goes_over_the_steps_of_a_cameras_fault():
    blob = CameraFault(condition="occluder", knots=3, curve="steps", at=1, lasts=3)
    application = camera(o=blob)
    names = ("o[0]", "o[1]", "o[2]", "o_occluder_x", "o_occluder_y")
    assert application.parameters.names == names
    seen = pictures(application, [-1.0, 0.0, 1.0, 0.0, 0.0])
    hidden = [int((one != seen[-1]).any(axis=-1).sum()) for one in seen]
    assert hidden[:2] == [0, 0]
    assert 0 < hidden[2] < hidden[3]
    assert hidden[4:] == [0, 0, 0]


def test_a_cameras_fault_at_every_step():
    env = StressEnv(camera(light=CameraFault(condition="exposure")))
    env.reset(seed=0)
    dark, *_ = env.step([-1.0])
    bright, *_ = env.step([1.0])
    assert dark.mean() < 60.0
    assert bright.mean() > 200.0
    with pytest.raises(UserError, match="Expected parameters that may change in each step"):
        StressEnv(camera(o=CameraFault(condition="occluder")))


def test_a_broken_sensor_stays_broken_and_noise_does_not():
    rows = pictures(camera(rows=CameraFault(condition="dead_rows")), [1.0])
    assert all(np.array_equal(one, rows[0]) for one in rows)
    noisy = pictures(camera(n=CameraFault(condition="noise")), [1.0])
    assert len({one.tobytes() for one in noisy}) == 7
    names = camera(o=CameraFault(0.1, 0.2, condition="occluder")).parameters
    assert names.names == ("o", "o_occluder_x", "o_occluder_y")
    assert names.parameters[0].high == 0.2


def slow(seen):
    time.sleep(0.002)
    return balance(seen)


def test_a_slow_agent_is_late():
    with pytest.warns(Notice, match="no score repeats exactly"):
        application = cart_pole(agent=slow, parameters={"slower": RealTime(0.1, 50.0, step=0.02)})
    assert not application.repeatable
    quick, late = application.evaluate([[-1.0], [1.0]], [0, 0]).infos
    assert late["length"] < 100 < quick["length"]
    with pytest.warns(Notice):
        real = cart_pole(parameters={"gravity": (5.0, 20.0), "real": RealTime(step=0.02)})
    assert real.evaluate([[0.0]], [0]).score[0] > 0.0


class Painted(gym.Wrapper):
    """Takes long to draw."""

    def render(self):
        time.sleep(0.1)
        return np.zeros((4, 4, 3), np.uint8)


def test_drawing_is_not_the_agents_time():
    with pytest.warns(Notice):
        application = cart_pole(
            environment=lambda render_mode=None: Painted(
                gym.make("CartPole-v1", render_mode=render_mode)
            ),
            parameters={"real": RealTime(1.0, 2.0, step=0.05)},
            max_steps=8,
            score=("length", 8),
        )
    _, score = application.replay([0.0], 0)
    assert score == 1.0


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        (Event(set=lengthen, lasts=(0, 9)), "at of 'it'"),
        (Event(set=lengthen, at=(5, 5), lasts=3), "a range such as"),
        (Event(set=lengthen, at=(-1, 5), lasts=3), "at of 'it'"),
        (Event(set=lengthen, at=(8, 9), lasts=3), "within an episode of 8 steps"),
        (Event(set=lengthen, at=(0, 5)), "lasts of 'it' to be a number of steps"),
        (Force(0.0, 1.0, apply=lengthen, start=3, steps=4, knots=5), "over which its knots lie"),
        (SensorFailure(at=(0, 5), lasts=3, entries=1), "entries of 'it' as a tuple"),
        (Event(set=3, at=(0, 5), lasts=3), "Expected a function set"),
        (Event(set=lengthen, at=3, lasts=3), "at least one Parameter"),
        (Event(0.0, 1.0, set=lengthen, at=3, lasts=3, knots=3), "may change during an episode"),
        (SensorFailure(at=(0, 5), lasts=3, mode="odd"), "mode of 'it'"),
        (SensorFailure(at=(0, 5), lasts=3, mode="noise"), "the standard deviation"),
        (SensorFailure(0.0, 1.0, at=(0, 5), lasts=3), "the standard deviation"),
        (SensorFailure(at=(0, 5), lasts=3, entries=(7,)), "entries of 'it'"),
        (ActuatorFailure(at=(0, 5), lasts=3, entries=(7,)), "entries of 'it'"),
        (ActuatorFailure(0.0, 1.0, at=(0, 5), lasts=3), "no low and high of 'it'"),
        (RealTime(0.0, 1.0, step=-1), "step of 'it' in seconds"),
        (CameraFault(condition="fear"), "condition of a camera"),
        (CameraFault(), "Expected pictures in Counting"),
    ],
)
def test_bad_events_are_told(binding, message):
    with pytest.raises(ValueError, match=message):
        counting(it=binding)


def test_zeros_are_for_numbers():
    with pytest.raises(ValueError, match=r"actions of numbers \(Box\) in Choosing"):
        counting(Choosing, it=ActuatorFailure(mode="zero", **TIMES))


def test_a_file_may_hold_events(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "happenings.py").write_text("def brake(env, value):\n    env.brake = value\n")
    table = {"kind": "event", "set": "happenings:brake", "at": [0, 500], "lasts": [1, 50]}
    path = tmp_path / "own.toml"
    event = binding_of("brake", table, path)
    assert event.set.__name__ == "brake"
    assert (event.at, event.lasts) == ((0, 500), (1, 50))
    failure = {"kind": "sensor-failure", "at": [0, 5], "lasts": 3, "entries": [1], "mode": "zero"}
    assert binding_of("blind", failure, path) == SensorFailure(
        at=(0, 5), lasts=3, entries=(1,), mode="zero"
    )
    with pytest.raises(ValueError, match="module:function"):
        binding_of("brake", table | {"set": "happenings:fly"}, path)
