"""What any closed loop gets from the base: acting in lockstep, rollouts, inner tasks."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from sada_gym.agents.policy import POLICY_TILE, Policy
from sada_gym.application import Scored
from sada_gym.envs.episodes.base import Episodes, play, record
from sada_gym.envs.episodes.closed_loop import EpisodesApplication
from sada_gym.envs.episodes.task import Task, TaskEnv, TaskVectorEnv
from sada_gym.parameters import Parameter, ParameterSpace
from sada_gym.testing.purity import assert_pure


class Walks(Episodes):
    """Walkers on a line from 0, who want to come to their start's number in time."""

    task_id = "Walk-v0"
    observation_space = spaces.Dict({"left": spaces.Box(-9.0, 9.0, (1,), np.float32)})
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    LIMIT = 6

    def __init__(self, starts):
        super().__init__(starts)
        self.place, self.closed = np.zeros(len(self)), 0

    def begin(self, i, start):
        self.starts[i], self.place[i], self.steps[i] = start, 0.0, 0

    @property
    def arrived(self):
        return np.abs(self.place - self.starts) < 0.5

    def under_way(self):
        return np.flatnonzero(~self.arrived & (self.steps < self.LIMIT))

    @property
    def score(self):
        return self.arrived.astype(float)

    def observe(self, which):
        left = np.asarray(self.starts)[which] - self.place[which]
        return {"left": left[:, None].astype(np.float32)}

    def render(self, which):
        return np.zeros((len(which), 2, 2, 3), np.uint8)

    def step(self, which, actions):
        self.place[which] += np.clip(actions[:, 0], -1.0, 1.0)
        self.steps[which] += 1

    def snapshot(self):
        return {"place": self.place}

    def close(self):
        self.closed += 1


class Walker:
    """Walks to where it should, a step at a time."""

    fingerprint = "walker"

    def start(self, count):
        self.count = count

    def act(self, episodes, which):
        return np.sign(episodes.observe(which)["left"])


class Model:
    """A model with a walker's spaces."""

    observation_space, action_space = Walks.observation_space, Walks.action_space

    def __init__(self, answer=None):
        self.answer = answer

    def predict(self, observation, *, deterministic):
        left = observation["left"]
        assert deterministic
        assert len(left) == POLICY_TILE
        return np.sign(left) if self.answer is None else np.full_like(left, self.answer), None


@dataclass(frozen=True)
class Goals:
    far: float = 3.0

    def draw(self, rng):
        return float(rng.uniform(1.0, self.far))


class WalkTask(Task):
    episodes_class, distribution_class = Walks, Goals

    def _begin(self, starts):
        return Walks(starts)

    def _step(self, episodes, actions):
        episodes.step(np.arange(len(episodes)), actions)
        return episodes.score

    def ended(self):
        arrived = self.episodes.arrived
        return arrived, ~arrived & (self.episodes.steps >= Walks.LIMIT)

    def info(self, i):
        return {"place": float(self.episodes.place[i])}


class WalkEnv(TaskEnv):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012
    task_class = WalkTask


class WalkVectorEnv(TaskVectorEnv):
    metadata = {**WalkEnv.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    task_class = WalkTask


class WalkApplication(EpisodesApplication):
    name = "Walk"
    fooling_threshold, sample_size = 0.5, 10
    parameters = ParameterSpace(Parameter("goal", 0.0, 9.0), Parameter("shift", -0.4, 0.4))

    def _as_agent(self, given):
        return given

    def episodes(self, mu, seeds):
        return Walks(self.parameters.physical(mu).sum(axis=1).tolist())

    def evaluate_batch(self, mu, seeds):
        walks = self.episodes(mu, seeds)
        self.play(walks)
        return Scored(walks.score, [{"place": float(place)} for place in walks.place])

    def _frames(self, rollouts):
        return [np.zeros((2, 2, 3), np.uint8) for _ in rollouts[0]["place"]]


def test_an_agent_acts_in_each_episode_to_its_end():
    walks, walker, seen = Walks([2.0, -4.0, 9.0, 0.0]), Walker(), []
    play(walker, walks, lambda now: seen.append(now.place.copy()))
    assert walker.count == 4
    assert walks.steps.tolist() == [2, 4, 6, 0]
    assert walks.score.tolist() == [1, 1, 0, 1]
    assert len(seen) == 6
    assert not seen[0].any()


def test_a_rollout_has_every_moment_of_its_own_episode():
    rollouts = record(Walker(), Walks([2.0, -4.0, 9.0]))
    assert [rollout["place"].tolist() for rollout in rollouts] == [
        [0, 1, 2],
        [0, -1, -2, -3, -4],
        [0, 1, 2, 3, 4, 5, 6],
    ]
    assert [rollout.start for rollout in rollouts] == [2.0, -4.0, 9.0]
    assert [rollout.score for rollout in rollouts] == [1, 1, 0]


def test_a_policy_acts_in_any_episodes():
    walks = Walks(np.linspace(-5, 5, 20).tolist())
    play(Policy(Model(), Walks), walks)
    assert walks.score.all()


@pytest.mark.parametrize("finite_only", [True, False])
def test_episodes_say_whether_an_action_may_be_no_finite_number(finite_only, monkeypatch):
    monkeypatch.setattr(Walks, "finite_only", finite_only)
    walks, policy = Walks([2.0]), Policy(Model(np.nan), Walks)
    policy.start(1)
    if finite_only:
        with pytest.raises(ValueError, match=r"finite actions from Model, got .* at step 0\."):
            policy.act(walks, np.arange(1))
    else:
        assert np.isnan(policy.act(walks, np.arange(1))).all()


def test_an_application_of_episodes_is_pure_and_replays_what_it_evaluated():
    application = WalkApplication(Walker(), "walker")
    assert application.agent_name == "walker"
    assert_pure(application, n=5, sizes=(2, 3), other_process=False)
    frames, score = application.replay([-0.5, 0.0], 3)
    outcome = application.evaluate([[-0.5, 0.0]], [3])
    assert score == outcome.score[0] == 1.0
    assert len(frames) == 3


def test_inner_tasks_are_made_of_episodes():
    check_env(WalkEnv(render_mode="rgb_array"), skip_render_check=True)
    batch = WalkVectorEnv(num_envs=3)
    single = SyncVectorEnv([WalkEnv] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    first, others = batch.reset(seed=2)[0], single.reset(seed=2)[0]
    np.testing.assert_array_equal(first["left"], others["left"])
    for _ in range(12):
        ours, theirs = (env.step(np.ones((3, 1), np.float32)) for env in (batch, single))
        np.testing.assert_array_equal(ours[0]["left"], theirs[0]["left"])
        for mine, other in zip(ours[1:4], theirs[1:4], strict=True):
            np.testing.assert_array_equal(mine, other)


def test_a_copy_of_a_task_needs_a_reset_and_closing_closes_the_episodes():
    env = WalkEnv(Goals(2.0))
    env.reset(seed=0)
    again = pickle.loads(pickle.dumps(env))
    with pytest.raises(ResetNeeded, match="no episode has begun yet"):
        again.step(np.ones(1, np.float32))
    np.testing.assert_array_equal(again.reset(seed=0)[0]["left"], env.reset(seed=0)[0]["left"])
    walks = env.task.episodes
    env.close()
    env.close()
    assert walks.closed == 1
