"""Which environments can be attacked, and whether their scores are pure: the table of a page.

    python -m studies.environments
    python -m studies.environments Hopper-v5 PandaReach-v3

Each environment gets a small agent: a model that has learnt for a few steps, or a function. What it
can do does not matter here. An attack asks a few dozen worlds. "Pure" means that all scores are the
same to the last bit alone, in other batches, in another order and in another process. The last
column is the processor time of a step under attack, over that of a plain loop with the same agent,
which resets one environment. An environment whose package is missing is left out, with the line
that installs it. The script ends with exit code 1 if an attack fails or its scores are not pure.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import stable_baselines3

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import (
    ActionNoise,
    Attribute,
    Config,
    Function,
    Keyword,
    ObservationNoise,
)
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.errors import check_known
from sada_gym.foundations.determinism import one_thread
from sada_gym.testing.purity import assert_pure
from studies.without_hits import without_hits

BUDGET, SAMPLES = 40, 20
PURE_WORLDS, TIMED_WORLDS, LEARNT_STEPS = 5, 12, 128
INSTALL = "pip install -c constraints.txt '.[{}]'"


@dataclass(frozen=True)
class Case:
    """One environment, what changes in it, and who acts.

    `agent` is the name of a class of SB3, which learns for `LEARNT_STEPS` steps, or a function.
    """

    environment: str | Callable[..., gym.Env[Any, Any]]
    package: str
    parameters: Mapping[str, Any]
    score: Any
    agent: str | Callable[[Any], Any]
    max_steps: int | None = None
    extra: str = "studies"
    policy: str = "MlpPolicy"
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    derived: Mapping[str, str] | None = None

    @property
    def name(self) -> str:
        """The environment's id without its module, or the function's name."""
        given = self.environment
        return given.rpartition(":")[2] if isinstance(given, str) else given.__name__

    @property
    def module(self) -> str:
        """The module that `package` installs."""
        return {"box2d": "Box2D"}.get(self.package, self.package.replace("-", "_"))


def set_gravity(env: Any, gravity: float) -> None:
    """Set the gravity of a world of PyBullet, in m/s²."""
    env.sim.physics_client.setGravity(0.0, 0.0, -gravity)


def set_mass(env: Any, mass_kg: float) -> None:
    """Set the mass of the object that the arm pushes."""
    sim = env.sim
    sim.physics_client.changeDynamics(sim._bodies_idx["object"], -1, mass=mass_kg)


def grid_with_obstacles(n_obstacles: int = 2) -> gym.Env[Any, Any]:
    """Make a grid with moving obstacles that shows its cells alone."""
    from minigrid.wrappers import ImgObsWrapper

    return ImgObsWrapper(gym.make("MiniGrid-Dynamic-Obstacles-6x6-v0", n_obstacles=n_obstacles))


def walk_to_goal(seen: Any) -> int:
    """Walk on where nothing stands in front, else turn right."""
    in_front = seen["image"][3, 5, 0]
    return 2 if in_front in (1, 8) else 1


def reach(seen: Any) -> Any:
    """Move the hand towards the goal."""
    return np.clip(8.0 * (seen["desired_goal"] - seen["achieved_goal"]), -1.0, 1.0)


def follow_ball(frame: Any) -> int:
    """Move the right paddle of Pong towards the ball's row."""
    field_, ball = frame[34:194], (236, 236, 236)
    rows = np.flatnonzero((field_[:, 20:138] == ball).all(axis=2).any(axis=1))
    paddle = np.flatnonzero((field_[:, 140:144] == (92, 186, 92)).all(axis=2).any(axis=1))
    if not len(rows) or not len(paddle):
        return 0
    return 2 if rows.mean() < paddle.mean() else 3


def stand_at_17(seen: Any) -> int:
    """Take cards up to a sum of 16."""
    return int(seen[0] < 17)


HALF_TO_TWICE = partial(Attribute, 0.5, 2.0, factor=True)
MASS = HALF_TO_TWICE(paths=("model.body_mass", "model.body_inertia"))
CASES = (
    Case(
        "CartPole-v1",
        "gymnasium",
        {"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        ("length", 100),
        "PPO",
        100,
        derived={"polemass_length": "masspole * length"},
    ),
    Case("Acrobot-v1", "gymnasium", {"LINK_MASS_1": (0.5, 2.0)}, ("return", -200, 0), "DQN", 200),
    Case("FrozenLake-v1", "gymnasium", {"success_rate": (0.2, 1.0)}, ("return", 0, 1), "A2C", 100),
    Case(
        "Blackjack-v1",
        "gymnasium",
        {"natural": Keyword(choices=(False, True)), "noise": ActionNoise(0.0, 1.0)},
        ("return", -1.0, 1.5),
        stand_at_17,
        50,
    ),
    Case(
        "LunarLander-v3",
        "box2d",
        {"gravity": (-11.9, -4.0), "wind_power": (0.0, 20.0)},
        ("return", -500, 300),
        "PPO",
        150,
        "examples",
        env_kwargs={"enable_wind": True},
    ),
    Case(
        "BipedalWalker-v3",
        "box2d",
        {"noise": ObservationNoise(0.0, 0.5), "gain": ActionNoise(0.0, 0.5)},
        ("return", -120, 300),
        "TD3",
        100,
        "examples",
    ),
    Case(
        "Hopper-v5",
        "mujoco",
        {
            "friction": HALF_TO_TWICE(paths="model.geom_friction[:,0]"),
            "mass": MASS,
            "timestep": HALF_TO_TWICE(paths="model.opt.timestep"),
        },
        ("return", 0, 200),
        "SAC",
        100,
        "examples",
    ),
    Case(
        "HalfCheetah-v5",
        "mujoco",
        {"friction": HALF_TO_TWICE(paths="model.geom_friction[:,0]")},
        ("return", -100, 100),
        "TD3",
        60,
        "examples",
    ),
    Case(
        "minigrid:MiniGrid-LavaGapS5-v0",
        "minigrid",
        {"size": Keyword(5, 7, integer=True), "noise": ActionNoise(0.0, 1.0)},
        ("return", 0, 1),
        walk_to_goal,
        60,
    ),
    Case(
        grid_with_obstacles,
        "minigrid",
        {"n_obstacles": Keyword(0, 4, integer=True)},
        ("return", -1, 1),
        "PPO",
        60,
    ),
    Case(
        "highway_env:highway-fast-v0",
        "highway-env",
        {"vehicles_density": Config(0.5, 2.0)},
        ("return", 0, 30),
        "DQN",
        20,
    ),
    Case(
        "panda_gym:PandaReach-v3",
        "panda-gym",
        {"gravity": Function(0.0, 20.0, set=set_gravity), "noise": ActionNoise(0.0, 1.0)},
        "success",
        reach,
        30,
    ),
    Case(
        "panda_gym:PandaPush-v3",
        "panda-gym",
        {"mass": Function(0.2, 5.0, set=set_mass)},
        "success",
        "SAC",
        30,
        policy="MultiInputPolicy",
    ),
    Case(
        "gymnasium_robotics:PointMaze_UMaze-v3",
        "gymnasium-robotics",
        {"mass": MASS, "noise": ActionNoise(0.0, 1.0)},
        "success",
        reach,
        100,
    ),
    Case(
        "gymnasium_robotics:AdroitHandDoor-v1",
        "gymnasium-robotics",
        {"friction": HALF_TO_TWICE(paths="model.geom_friction[:,0]")},
        ("return", -50, 50),
        "TD3",
        40,
    ),
    Case(
        "ale_py:ALE/Pong-v5",
        "ale-py",
        {"repeat_action_probability": (0.0, 0.9), "frameskip": Keyword(2, 6, integer=True)},
        ("return", -5, 5),
        follow_ball,
        60,
    ),
    Case(
        "ale_py:ALE/Breakout-v5",
        "ale-py",
        {"repeat_action_probability": (0.0, 0.9)},
        ("return", 0, 5),
        "PPO",
        60,
        policy="CnnPolicy",
    ),
    Case(
        "gymnasium_robotics:FetchReach-v4",
        "gymnasium-robotics",
        {"noise": ActionNoise(0.0, 1.0)},
        "success",
        reach,
        50,
    ),
)


def learnt(case: Case) -> Any:
    """Return the agent of a case: a model that has learnt for a few steps, or a function."""
    if callable(case.agent):
        return case.agent
    small = {
        "PPO": {"n_steps": 64, "batch_size": 32},
        "A2C": {},
    }.get(case.agent, {"buffer_size": 1_000})
    kind = getattr(stable_baselines3, case.agent)
    with closing(factory(case).make({})) as env:
        return kind(case.policy, env, seed=0, device="cpu", **small).learn(LEARNT_STEPS)


def factory(case: Case) -> EnvFactory:
    """Return what makes the environments of a case."""
    return EnvFactory(case.environment, case.env_kwargs, case.max_steps)


def loop(case: Case, agent: Any) -> int:
    """Play episodes in one environment; return the number of steps."""
    steps = 0
    with closing(factory(case).make({})) as env:
        for seed in range(TIMED_WORLDS):
            seen, _ = env.reset(seed=seed)
            ended = False
            while not ended:
                action = agent(seen) if callable(agent) else predicted(agent, seen)
                seen, _, terminated, truncated, _ = env.step(action)
                ended, steps = terminated or truncated, steps + 1
    return steps


def predicted(model: Any, seen: Any) -> Any:
    """Return the action of a model, a whole number where it chooses."""
    action, _ = model.predict(seen, deterministic=True)
    return action if action.ndim else int(action)


def time_ratio(case: Case, application: GymnasiumApplication, agent: Any) -> float:
    """Return the processor time of a step under attack over that of a plain loop."""
    rng = np.random.default_rng(0)
    shape = (TIMED_WORLDS, len(application.parameters))
    mu = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
    ratios = []
    for _ in range(3):
        began = time.process_time()
        infos = application.evaluate(mu, range(TIMED_WORLDS)).infos
        between = time.process_time()
        steps = loop(case, agent)
        ours = (between - began) / sum(info["length"] for info in infos)
        ratios.append(ours * steps / (time.process_time() - between))
    return float(np.median(ratios))


def cells(case: Case, out: Path) -> Iterator[str]:
    """Yield the cells of a row after the parameters: fooled, invalid, pure, and a step's time."""
    agent = learnt(case)
    application = GymnasiumApplication(
        case.environment,
        agent=agent,
        parameters=case.parameters,
        score=case.score,
        fooling_threshold=0.5,
        max_steps=case.max_steps,
        env_kwargs=case.env_kwargs,
        derived=case.derived,
        agent_id="a small agent",
    )
    with closing(application):
        found = attack(
            application,
            "level-set",
            budget=BUDGET,
            samples=SAMPLES,
            options=without_hits("level-set"),
            out=out,
            pictures=False,
            progress=False,
        )
        yield f"{100 * found.result.afr:.0f}"
        assert_pure(application, n=PURE_WORLDS, sizes=(1, 3))
        yield "yes"
        with one_thread():
            yield f"{time_ratio(case, application, agent):.2f}"


def row(case: Case, out: Path) -> tuple[str, bool]:
    """Return a row of the table, and whether the environment was attacked and is pure."""
    name = case.agent if isinstance(case.agent, str) else case.agent.__name__
    head = [f"`{case.name}`", f"{case.package} {version(case.package)}", name]
    found, fault = [], False
    try:
        for cell in cells(case, out):
            found.append(cell)
    except Exception as error:  # whatever an environment's package raises
        found, fault = [*found, f"{type(error).__name__}: {' '.join(str(error).split())}"], True
    found += ["-"] * (3 - len(found))
    return f"| {' | '.join([*head, ', '.join(case.parameters), *found])} |", not fault


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("environments", nargs="*", help="by default all")
    options = parser.parse_args()
    check_known("environment", options.environments, [case.name for case in CASES])
    all_well = True
    table = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # PyBullet's C code writes into stdout
    print("| environment | package | agent | parameters | fooled, % | pure | a step |", file=table)
    print("| --- | --- | --- | --- | --- | --- | --- |", file=table)
    with tempfile.TemporaryDirectory() as folder:
        for i, case in enumerate(CASES):
            if options.environments and case.name not in options.environments:
                continue
            try:
                importlib.import_module(case.module)
            except ImportError:
                text, well = f"| `{case.name}` | left out: {INSTALL.format(case.extra)} |", True
            else:
                text, well = row(case, Path(folder) / str(i))
            print(text, file=table, flush=True)
            all_well = all_well and well
    sys.exit(not all_well)


if __name__ == "__main__":
    main()
