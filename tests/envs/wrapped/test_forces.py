"""Tests of wind and pushes on bodies of MuJoCo's, PyBullet's and Box2D's, and of other forces."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from wrapped_toys import cart_pole

from sada_gym.envs.wrapped import Force, Push, RepeatedActions, Wind


def idle(environment, steps=12):
    made = gym.make(environment) if isinstance(environment, str) else environment()
    space = made.action_space
    action = np.zeros(space.shape) if isinstance(space, gym.spaces.Box) else 0
    return {
        "environment": environment,
        "agent": lambda seen: action,
        "score": ("length", steps),
        "max_steps": steps,
    }


def run(environment, *, at, seed=0, steps=12, look, **parameters):
    """What `look` sees of the environment before each step and after the last one."""
    application = cart_pole(**idle(environment, steps), parameters=parameters)
    episodes = application.episodes(np.array([at], np.float32), [seed])
    (episode,) = episodes.running
    world, seen = episode.env.unwrapped, []
    while not episode.ended:
        seen.append(look(world))
        episode.step(
            0 if not episodes.action_space.shape else np.zeros(episodes.action_space.shape)
        )
    return np.array([*seen, look(world)])


@pytest.fixture
def box2d():
    pytest.importorskip("Box2D", reason="Box2D is not installed: pip install '.[examples]'")


@pytest.fixture
def mujoco():
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")


def lander(world):
    return tuple(world.lander.linearVelocity)


def speed_up(forced, plain):
    """By how much each step changes the velocity beside that without a force."""
    return np.diff(forced - plain, axis=0)


def test_wind_pushes_the_lander_in_every_step(box2d):
    plain = run("LunarLander-v3", at=[0.0], look=lander, wind=Wind(-5.0, 5.0))
    wind = run("LunarLander-v3", at=[1.0], look=lander, wind=Wind(-5.0, 5.0))
    steps = speed_up(wind, plain)
    world = gym.make("LunarLander-v3").unwrapped
    world.reset(seed=0)
    assert steps[:, 0] == pytest.approx(5.0 / 50 / world.lander.mass, rel=0.2)
    assert (np.abs(steps[:, 1]) < 0.1 * steps[:, 0]).all()
    up = Wind(-5.0, 5.0, direction=(0, 3))
    steps = speed_up(run("LunarLander-v3", at=[-1.0], look=lander, wind=up), plain)
    assert (steps[:, 1] < -0.5 * 5.0 / 50 / world.lander.mass).all()


def test_a_push_lasts_for_its_steps(box2d):
    plain = run("LunarLander-v3", at=[-1.0], look=lander, push=Push(0.0, 5.0, start=3, steps=2))
    pushed = run("LunarLander-v3", at=[1.0], look=lander, push=Push(0.0, 5.0, start=3, steps=2))
    steps = speed_up(pushed, plain)[:, 0]
    assert (steps[3:5] > 10 * np.abs(steps[:3]).max(initial=1e-6)).all()
    assert (np.abs(steps[5:]) < 0.2 * steps[3]).all()


def test_each_episode_draws_the_beginning_of_its_push(box2d):
    push = Push(0.0, 5.0, start=(2, 9), steps=1)
    starts = set()
    for seed in range(8):
        plain, pushed = (
            run("LunarLander-v3", at=[at], look=lander, seed=seed, push=push) for at in (-1.0, 1.0)
        )
        starts.add(int(np.argmax(speed_up(pushed, plain)[:, 0])))
    assert starts <= set(range(2, 10))
    assert len(starts) > 2


def test_forces_add_up_in_mujoco_and_leave_nothing_behind(mujoco):
    def looked(**parameters):
        def look(world):
            left.append(world.data.xfrc_applied.copy())
            return world.data.qvel[:2].copy()

        left = []
        seen = run("Hopper-v5", at=[1.0] * len(parameters), look=look, steps=5, **parameters)
        assert not np.any(left)
        return seen[-1]

    plain = looked(wind=Wind(-1.0, 0.0))
    assert looked(wind=Wind(0.0, 20.0))[0] > plain[0]
    back = Wind(-20.0, 20.0, direction=(-1, 0, 0))
    assert looked(wind=back)[0] < plain[0]
    lifted = looked(wind=Wind(0.0, 20.0), lift=Wind(0.0, 90.0, body="foot", direction=(0, 0, 2)))
    assert lifted[1] > plain[1] + 0.01
    both = looked(a=Wind(0.0, 10.0), b=Push(0.0, 10.0, start=0, steps=9))
    assert both == pytest.approx(looked(wind=Wind(0.0, 20.0)), abs=1e-9)


def test_a_force_counts_steps_of_the_environment(box2d):
    push = {"push": Push(0.0, 5.0, start=4, steps=2), "slow": RepeatedActions(1, 3)}
    plain, pushed = (run("LunarLander-v3", at=[at, 1.0], look=lander, **push) for at in (-1.0, 1.0))
    assert np.argmax(speed_up(pushed, plain)[:, 0]) == 1  # the third to the fifth step


def test_without_force_a_world_is_what_it_was(box2d):
    none = cart_pole(**idle("LunarLander-v3"), parameters={"w": Wind(-1.0, 1.0)})
    assert none.nominal.tolist() == [0.0]
    other = cart_pole(**idle("LunarLander-v3"), parameters={"gravity": (-11.0, -9.0)})
    seen = [a.evaluate([[0.0]], [3]).infos[0]["return"] for a in (none, other)]
    assert seen[0] == seen[1]


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        (Wind(-1.0, 1.0, body="wing"), r"found none at 'wing'\. Name an attribute"),
        (Wind(-1.0, 1.0, direction=(1.0, 0.0, 0.0)), "direction of 'w' to be 2 numbers"),
        (Wind(-1.0, 1.0, direction=(0.0, 0.0)), "not all 0"),
        (Wind(-1.0, 1.0, direction="x"), "to be 2 numbers"),
        (Push(0.0, 1.0, steps=0), "steps of 'w' of at least 1"),
        (Push(0.0, 1.0, start=-1), "start of 'w' of at least 0"),
        (Push(0.0, 1.0, start=(5, 2)), "the first and the last one"),
        (Push(0.0, 1.0, start=(1, 2, 3)), "the first and the last one"),
    ],
)
def test_what_is_no_force_gets_a_sentence(box2d, binding, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(**idle("LunarLander-v3"), parameters={"w": binding})


def test_an_environment_without_bodies_gets_a_sentence():
    with pytest.raises(
        ValueError, match="body of MuJoCo, PyBullet or Box2D of CartPole-v1 for 'w', found none"
    ):
        cart_pole(parameters={"w": Wind(-1.0, 1.0)})


def test_an_unknown_body_of_mujoco_gets_the_names(mujoco):
    with pytest.raises(
        ValueError, match=r"one of torso, thigh, leg, foot; got 'tors'\. Did you mean"
    ):
        cart_pole(**idle("Hopper-v5"), parameters={"w": Wind(-1.0, 1.0, body="tors")})


def test_two_forces_of_the_same_kind_need_two_directions(box2d):
    with pytest.raises(ValueError, match="one Wind, got 'a' and 'b'"):
        cart_pole(**idle("LunarLander-v3"), parameters={"a": Wind(0.0, 1.0), "b": Wind(0.0, 2.0)})
    both = {"a": Wind(0.0, 1.0), "b": Wind(0.0, 1.0, direction=(0.0, 1.0))}
    assert len(cart_pole(**idle("LunarLander-v3"), parameters=both).parameters) == 2


class Ball(gym.Env):
    """A ball of 2 kg in PyBullet, without gravity; a step is four of the simulator's."""

    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(1)

    def __init__(self, fixed=False):
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

        self.client, self.fixed = BulletClient(pybullet.DIRECT), fixed

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.client.resetSimulation()
        shape = self.client.createCollisionShape(2, radius=0.1)
        self.ball = self.client.createMultiBody(
            0.0 if self.fixed else 2.0, shape, basePosition=[0, 0, 1]
        )
        self.client.changeDynamics(self.ball, -1, linearDamping=0, angularDamping=0)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        for _ in range(4):
            self.client.stepSimulation()
        return np.zeros(1, np.float32), 0.0, False, False, {}

    def close(self):
        self.client.disconnect()


def velocity(world):
    return np.array(world.client.getBaseVelocity(world.ball)[0])


@pytest.mark.parametrize("direction", [None, (0, 0, 3)])
def test_a_force_acts_in_all_steps_of_pybullet(direction):
    push = Push(0.0, 12.0, start=1, steps=2, direction=direction)
    seen = run(Ball, at=[1.0], look=velocity, steps=5, push=push)
    gained = np.diff(seen, axis=0) @ ((1, 0, 0) if direction is None else (0, 0, 1))
    assert gained == pytest.approx([0, 6 * 4 / 240, 6 * 4 / 240, 0, 0], abs=1e-6)
    both = {"a": Wind(0.0, 4.0), "b": Wind(0.0, 8.0, direction=(0, 1, 0))}
    seen = run(Ball, at=[1.0, 1.0], look=velocity, steps=3, **both)
    assert seen[-1] == pytest.approx([2 * 12 / 240, 4 * 12 / 240, 0], abs=1e-6)


def test_a_fixed_body_of_pybullet_is_none_to_push():
    with pytest.raises(ValueError, match="that is not fixed, got none"):
        cart_pole(
            **idle(partial(Ball, fixed=True)),
            parameters={"w": Wind(0.0, 1.0)},
        )


def test_links_and_bodies_of_panda_gym_have_names():
    pytest.importorskip("panda_gym", reason="panda-gym is not installed")
    make = "panda_gym:PandaPush-v3"
    place = run(make, at=[0.0], look=_object, steps=8, w=Wind(-9.0, 9.0, body="object"))
    moved = run(make, at=[1.0], look=_object, steps=8, w=Wind(-9.0, 9.0, body="object"))
    assert moved[-1, 0] > place[-1, 0] + 0.01
    with pytest.raises(ValueError, match=r"panda_hand.*Did you mean object"):
        cart_pole(**idle(make), parameters={"w": Wind(0.0, 1.0, body="objekt")})


def _object(world):
    return world.sim.get_base_position("object")


def blow(world, strength):
    world.wind_mag = strength
    return lambda: setattr(world, "wind_mag", 0.0)


def fail(world, strength):
    raise RuntimeError("no wind today")


def test_a_function_of_ones_own_is_a_force():
    class Sled(gym.Env):
        observation_space = Ball.observation_space
        action_space = Ball.action_space

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.wind_mag, self.speed = 0.0, 0.0
            return np.zeros(1, np.float32), {}

        def step(self, action):
            self.speed += self.wind_mag
            return np.zeros(1, np.float32), 0.0, False, False, {}

    def look(world):
        return world.speed

    assert run(Sled, at=[1.0], look=look, steps=3, w=Force(0.0, 2.0, apply=blow)).tolist() == [
        *(0, 2, 4, 6)
    ]
    push = Force(0.0, 2.0, apply=blow, start=1, steps=1)
    assert run(Sled, at=[1.0], look=look, steps=3, w=push).tolist() == [0, 0, 2, 2]
    with pytest.raises(ValueError, match=r"to let a force of .* act, got RuntimeError: no wind"):
        cart_pole(
            **idle(Sled), parameters={"w": Force(0.0, 2.0, apply=fail)}, on_error="raise"
        ).evaluate([[1.0]], [0])
    with pytest.raises(TypeError, match=r"a function apply\(env, strength\) for 'w', got None"):
        cart_pole(**idle(Sled), parameters={"w": Force(0.0, 2.0)})
    with pytest.raises(ValueError, match="steps of 'w' of at least 1"):
        cart_pole(**idle(Sled), parameters={"w": Force(0.0, 2.0, apply=blow, start=1, steps=0)})
