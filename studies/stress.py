"""What is an adversary at every step worth? Four ways to find likely failures, at equal steps.

    python -m studies.stress run cart-pole --seeds 0 1 2     # goes on where it stopped
    python -m studies.stress table

Standard normal numbers disturb each agent in every step. The smaller they are, the likelier is a
failure: the tables have half the sum of their squares until it fails. `walk` is the example of
POMDPStressTesting.jl (Moss et al. 2021): steps of a normal random walk, and a failure beyond 10
within 30 steps. Its likeliest failure is known: 30 equal steps of 1/3, half the sum 1.67.

- `draws`: disturbances as they are in ordinary use, which is plain Monte Carlo.
- `cross-entropy` over whole sequences (Rubinstein 1999), Gaussian and independent in each step.
- `ppo`: PPO of Stable-Baselines3 on `StressEnv`, as adaptive stress testing has it.
- `level-set`: over profiles, ten knots a disturbance within 3 standard deviations.

Failures are of one kind where they happen in the same tenth of the longest episode, and each
disturbance has the same sign on average over the tenth before. A run's episodes all begin in one
world, the first from a hundred times its seed on in which the agent passes undisturbed.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

import sada_gym
from sada_gym import GymnasiumApplication, StressEnv, adversaries
from sada_gym.envs.wrapped import Attribute
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.arrays import Floats
from studies.kept_rows import add_row, read_rows

FOLDER = Path("docs/results/stress")
METHODS = ("draws", "cross-entropy", "ppo", "level-set")
KNOTS, WIDEST = 10, 3.0


class Walk(gym.Env[Any, Any]):
    """A random walk that nobody controls; Moss et al.'s Walk1D."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float64)
    step_0 = 0.0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:  # noqa: ARG002
        super().reset(seed=seed)
        self.steps, self.place = 0, 0.0
        return np.zeros(1), {}

    def step(self, action: Any) -> Any:  # noqa: ARG002
        self.steps, self.place = self.steps + 1, self.place + self.step_0
        far = abs(self.place) >= 10.0
        return np.array([self.place]), 0.0, far, self.steps >= 30, {}


class Shipped(gym.Env[Any, Any]):
    """An application of this package in its nominal world, with its own agent in it."""

    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float64)
    push_0 = push_1 = 0.0

    def __init__(self, name: str, push: Callable[[Any, Floats], None]) -> None:
        self.application: Any = sada_gym.make_application(name)
        self._push = push
        middle = np.zeros(len(self.application.parameters), np.float32)
        nominal = self.application.nominal
        self._mu = (middle if nominal is None else nominal)[None]
        self._episodes = self.application.episodes(self._mu, [0])
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, self._seen().shape, np.float64)

    def _seen(self) -> Floats:
        observed = self._episodes.observe(np.zeros(1, np.intp))
        return np.concatenate([np.ravel(part) for part in observed.values()]).astype(np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:  # noqa: ARG002
        super().reset(seed=seed)
        self._episodes.close()
        self._episodes = self.application.episodes(self._mu, [int(seed or 0)])
        self.application.policy.start(1)
        return self._seen(), {}

    def step(self, action: Any) -> Any:  # noqa: ARG002
        which = np.zeros(1, np.intp)
        self._push(self._episodes, np.array([self.push_0, self.push_1]))
        actions = self.application.policy.act(self._episodes, which)
        self._episodes.step(which, actions)
        ended = 0 not in self._episodes.under_way()  # a world may have several episodes
        return self._seen(), float(self._episodes.score[0]), ended, False, {}


def _normal(sd: float) -> Attribute:
    return Attribute(-5.0 * sd, 5.0 * sd, nominal={"normal": [0.0, sd]})


def walk() -> GymnasiumApplication:
    return GymnasiumApplication(
        Walk,
        agent=lambda seen: np.zeros(1),  # noqa: ARG005
        parameters={"step_0": _normal(1.0)},
        score=lambda episode: max(1.0 - abs(episode.observations[-1][0]) / 10.0, 0.0),
        fooling_threshold=0.0,
        max_steps=30,
    )


class WindyCartPole(gym.Wrapper[Any, Any, Any, Any]):
    """CartPole whose cart a wind pushes."""

    def step(self, action: Any) -> Any:
        env: Any = self.unwrapped
        env.state = np.asarray(env.state) + np.array([0.0, env.wind, 0.0, 0.0])
        return self.env.step(action)


def _cart_pole() -> Any:
    env = gym.make("CartPole-v1")
    env.unwrapped.wind = 0.0  # type: ignore[attr-defined]
    return WindyCartPole(env)


def pole(wind: Attribute) -> GymnasiumApplication:
    """Return a pole in a wind, and a controller written by hand."""
    return GymnasiumApplication(
        _cart_pole,
        agent=lambda seen: int(seen[2] + 0.5 * seen[3] + 0.02 * seen[0] + 0.1 * seen[1] > 0),
        agent_id="by hand",
        parameters={"wind": wind},
        score=lambda episode: max(
            1.0 - np.abs(np.array(episode.observations)[:, 2]).max() / 0.2095, 0.0
        ),
        fooling_threshold=0.0,
        max_steps=100,
    )


def cart_pole() -> GymnasiumApplication:
    return pole(_normal(0.1))


class WindyLander(gym.Wrapper[Any, Any, Any, Any]):
    """A lander that gusts push to the side and down."""

    def step(self, action: Any) -> Any:
        env: Any = self.unwrapped
        x, y = env.lander.linearVelocity
        env.lander.linearVelocity = (float(x + env.gust_x), float(y + env.gust_y))
        return self.env.step(action)


def _lander() -> Any:
    env = gym.make("LunarLander-v3")
    env.unwrapped.gust_x = env.unwrapped.gust_y = 0.0  # type: ignore[attr-defined]
    return WindyLander(env)


def lander() -> GymnasiumApplication:
    from gymnasium.envs.box2d.lunar_lander import heuristic

    engines = SimpleNamespace(unwrapped=SimpleNamespace(continuous=False))
    return GymnasiumApplication(
        _lander,
        agent=lambda seen: int(heuristic(engines, seen)),
        parameters={"gust_x": _normal(0.15), "gust_y": _normal(0.15)},
        score=("return", 0.0, 300.0),
        fooling_threshold=0.0,
        max_steps=400,
    )


def _gust(episodes: Any, strength: Floats) -> None:
    episodes.winds[0, :2] += strength


def _shove(episodes: Any, strength: Floats) -> None:
    episodes._robots[0]._data.qvel[:2] += strength


def _swerve(episodes: Any, strength: Floats) -> None:
    episodes.commands[0, 0] += strength


SHIPPED = {
    "robot": ("SADA-Robot-Warehouse-v0", _swerve, 200),
    "go2": ("SADA-Go2-Walk-v0", _shove, 300),
    "quadrotor": ("SADA-Quadrotor-Crazyflie-v0", _gust, 1_000),
}
"""The id, what disturbs its agent, and the most steps of an episode."""


def shipped(name: str, push: Attribute) -> GymnasiumApplication:
    """Return a shipped agent with two disturbances: wind, pushes (m/s), or wrong commands."""
    env_id, disturb, steps = SHIPPED[name]
    return GymnasiumApplication(
        lambda: Shipped(env_id, disturb),
        agent="built-in",
        parameters={"push_0": push, "push_1": push},
        score=lambda episode: episode.rewards[-1],
        fooling_threshold=sada_gym.make_application(env_id).fooling_threshold,
        max_steps=steps,
        agent_id=env_id,
    )


SYSTEMS: dict[str, Callable[[], GymnasiumApplication]] = {
    "walk": walk,
    "cart-pole": cart_pole,
    "lander": lander,
    "robot": lambda: shipped("robot", _normal(0.2)),
    "go2": lambda: shipped("go2", _normal(0.05)),
    "quadrotor": lambda: shipped("quadrotor", _normal(0.5)),
}


class Counted(gym.Wrapper[Any, Any, Any, Any]):
    """Counts steps, begins all episodes in one world, and keeps what fails."""

    def __init__(self, env: StressEnv, seed: int, steps: int, limit: int) -> None:
        super().__init__(env)
        self.seed, self.left, self.limit = seed, steps, limit
        self.best, self.kinds, self.failed, self.episodes = np.inf, set[Any](), 0, 0
        self.first: int | None = None
        self._given: list[Floats] = []

    def reset(self, **_: Any) -> Any:
        self._given = []
        return self.env.reset(seed=self.seed)

    def step(self, action: Any) -> Any:
        self.left -= 1
        self._given.append(np.clip(np.asarray(action, np.float64), -5.0, 5.0))
        answer = self.env.step(action)
        if answer[2]:
            self.episodes += 1
            if answer[4]["fooled"]:
                self._keep(np.array(self._given))
        return answer

    def _keep(self, given: Floats) -> None:
        tenth = max(self.limit // 10, 1)
        before = given[-tenth:].mean(axis=0)
        self.kinds.add((len(given) // tenth, *(before > 0.0).tolist()))
        self.best = min(self.best, 0.5 * float((given**2).sum()))
        self.failed += 1

    def play(self, given: Floats) -> tuple[float, bool]:
        """Play an episode with disturbances, (T, k): its return, and whether it fails."""
        self.reset()
        total, ended, step, info = 0.0, False, 0, {}
        while not ended:
            _, reward, ended, _, info = self.step(given[min(step, len(given) - 1)])
            total, step = total + float(reward), step + 1
        self.score = float(info["score"])
        return total, bool(info["fooled"])


def passing_seed(env: StressEnv, first: int) -> int:
    """Return the first seed from one on whose world the agent passes undisturbed."""
    calm = np.zeros((1, *(env.action_space.shape or ())))
    return next(seed for seed in count(first) if not Counted(env, seed, 0, 1).play(calm)[1])


def by_draws(env: Counted, k: int, seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    while env.left > 0:
        env.play(rng.standard_normal((env.limit, k)))


def by_cross_entropy(env: Counted, k: int, seed: int) -> None:
    """The elite are a fifth; a round has 24 episodes."""
    rng = np.random.default_rng([seed, 2])
    mean, spread = np.zeros((env.limit, k)), np.ones((env.limit, k))
    while env.left > 0:
        given = mean + spread * rng.standard_normal((24, env.limit, k))
        returns = np.array([env.play(one)[0] for one in given if env.left > 0])
        elite = given[: len(returns)][np.argsort(-returns)[:5]]
        mean, spread = elite.mean(axis=0), elite.std(axis=0) + 0.03


def by_ppo(env: Counted, k: int, seed: int) -> None:  # noqa: ARG001
    from stable_baselines3 import PPO

    model = PPO("MlpPolicy", env, n_steps=1_024, batch_size=128, seed=seed, device="cpu")
    model.learn(env.left)


def by_level_set(env: Counted, k: int, seed: int) -> None:
    at = np.linspace(0.0, 1.0, KNOTS)
    over = np.linspace(0.0, 1.0, env.limit)

    def scores(mu: Floats) -> Floats:
        found = []
        for row in np.asarray(mu, np.float64):
            knots = WIDEST * row.reshape(k, KNOTS)
            env.play(np.stack([np.interp(over, at, one) for one in knots], axis=1))
            found.append(env.score)
        return np.array(found)

    threshold = env.env.application.fooling_threshold  # type: ignore[attr-defined]
    budget = int(0.9 * env.left / env.limit)
    solver = adversaries.make("level-set", dimension=KNOTS * k, seed=seed)
    with Oracle(scores, dimension=KNOTS * k, threshold=threshold, budget=budget, seed=seed) as o:
        solver.train(o)
    while env.left > 0:  # episodes that failed early left some steps
        scores(solver.sample(8))


SEARCHES = dict(zip(METHODS, (by_draws, by_cross_entropy, by_ppo, by_level_set), strict=True))


def read(system: str) -> list[dict[str, Any]]:
    return read_rows(FOLDER / f"{system}.jsonl")


def measure(system: str, seeds: list[int], steps: int) -> None:
    """Run what is missing, and write each run as it comes."""
    done = {(row["method"], row["seed"], row["steps"]) for row in read(system)}
    for seed in seeds:
        for method in METHODS:
            if (method, seed, steps) in done:
                continue
            start = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                application = SYSTEMS[system]()
                env = StressEnv(application, actions="normal", miss=300.0)
                k = env.action_space.shape[0]
                limit = int(application.step_limit or 0)
                counted = Counted(env, passing_seed(env, 100 * seed), steps, limit)
                SEARCHES[method](counted, k, seed)
            row = {
                "method": method,
                "seed": seed,
                "steps": steps,
                "episodes": counted.episodes,
                "failures": counted.failed,
                "kinds": len(counted.kinds),
                "half_sum": None if counted.best == np.inf else round(counted.best, 2),
                "seconds": round(time.process_time() - start, 1),
            }
            add_row(FOLDER / f"{system}.jsonl", row)


def table() -> str:
    lines = ["| agent | method | episodes | failures | kinds | likeliest |", "| --- " * 6 + "|"]
    for system in SYSTEMS:
        for method in METHODS:
            rows = [row for row in read(system) if row["method"] == method]
            if not rows:
                continue
            mean = {key: np.mean([row[key] for row in rows]) for key in ("episodes", "failures")}
            kinds = np.mean([row["kinds"] for row in rows])
            best = [row["half_sum"] for row in rows]
            shown = ", ".join("none" if one is None else f"{one:.1f}" for one in best)
            lines.append(
                f"| {system} | `{method}` | {mean['episodes']:,.0f} | {mean['failures']:,.0f} | "
                f"{kinds:.1f} | {shown} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("action", choices=("run", "table"))
    parser.add_argument("systems", nargs="*", default=list(SYSTEMS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=50_000)
    given = parser.parse_args()
    if given.action == "table":
        print(table())
        return
    for system in given.systems:
        measure(system, given.seeds, given.steps)


if __name__ == "__main__":
    main()
