"""Find where a balancer drops its pole, understand why, fix it, and guard the fix.

    python examples/fix_cartpole.py

It takes about five minutes of one core. `fix_cartpole.py 1` has another seed. The folder
runs/fix-cartpole/SEED gets both attacks, the suite, fixed.zip and before-after.png.
"""

import shutil
import sys
import textwrap
from math import sqrt
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from sada_gym import FailureCurriculum, GymnasiumApplication, Run, attack, export, regress
from sada_gym.envs.wrapped import ActionDelay

BUDGET = 500
TRAINING_STEPS = 60_000
WORLDS = 300


def knows_physics(state, env):
    """Act by how fast this pole falls, which the trained agent does not see."""
    pole = env.unwrapped
    falling_s = sqrt(pole.length * (4 / 3 - pole.masspole / pole.total_mass) / pole.gravity)
    return int(state @ np.array([0.02, 0.06, 1.0, 1.3 * falling_s]) > 0)


def make_application(agent: PPO) -> GymnasiumApplication:
    """Q is the share of 500 steps for which the pole stays up."""
    return GymnasiumApplication(
        "CartPole-v1",
        agent=agent,
        privileged=knows_physics,
        parameters={
            "delay": ActionDelay(0, 3, unit="steps"),
            "length": (0.25, 1.0),
            "masspole": (0.05, 0.2),
            "masscart": (0.5, 2.0),
            "gravity": (4.9, 19.6),
            "force_mag": (5.0, 20.0),
        },
        derived={"total_mass": "masspole + masscart", "polemass_length": "masspole * length"},
        score=("length", 500),
        fooling_threshold=0.5,
        agent_id="PPO, and a controller that knows the physics",
    )


def find(agent: PPO, folder: Path, seed: int) -> Run:
    """Attack the agent, and say how often it fails, and whether anybody could do better."""
    application = make_application(agent)
    run = attack(application, "level-set", budget=BUDGET, seed=seed, out=folder, progress=False)
    failures = run.result.fooled
    both = failures - run.result.feasible.fooled
    print(f"{run.result.afr:.0%} of level-set's new worlds fool the agent.")
    print(f"In {both} of these {failures} a controller that knows the physics fails too.")
    return run


def fix(agent: PPO, run: Run, seed: int) -> PPO:
    """Train on: half of the episodes where the agent fails, a quarter anywhere in the ranges."""
    application = make_application(agent)
    env = make_vec_env(lambda: FailureCurriculum(application, run.folder), n_envs=8, seed=seed)
    agent.save(run.folder / "agent.zip")
    fixed = PPO.load(run.folder / "agent.zip", env=env, device="cpu")
    return fixed.learn(3 * TRAINING_STEPS)


def draw(agents: dict[str, PPO], path: Path) -> None:
    """Let agents act in the same uniform worlds; say and draw in which ones each fails."""
    mu = np.random.default_rng(0).uniform(-1, 1, (WORLDS, 6)).astype(np.float32)
    applications = {name: make_application(agent) for name, agent in agents.items()}
    fails = {name: one.evaluate(mu, range(WORLDS)).fooled for name, one in applications.items()}
    space = applications["before"].parameters
    hard = applications["before"].privileged_score(mu, range(WORLDS)) <= 0.5
    who = "a controller that knows the physics"
    delay, length = 1.5 + 2 * mu[:, 0], space.physical(mu)[:, space.names.index("length")]
    figure, panels = plt.subplots(1, len(agents), figsize=(9, 4), sharey=True, layout="constrained")
    for panel, (name, failing) in zip(panels, fails.items(), strict=True):
        print(f"{name}: {failing.mean():.0%} of {WORLDS} uniform worlds fool the agent.")
        panel.scatter(length[~failing], delay[~failing], s=14, c="0.8", label="passes")
        panel.scatter(length[failing], delay[failing], s=14, c="tab:red", label="fails")
        panel.scatter(length[hard], delay[hard], s=50, marker="x", c="k", label=f"{who} fails")
        panel.set(title=f"{name}: {failing.mean():.0%} fail", xlabel="length of the pole (m)")
    panels[0].set(ylabel="delay (steps)", yticks=range(4))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=110)
    print(f"{hard.mean():.0%} of them fool {who}.\nPicture: {path}")


def main(seed: int) -> None:
    """Train a balancer, then go the whole way with it."""
    torch.set_num_threads(1)  # small networks train several times faster in one thread
    folder = Path(f"runs/fix-cartpole/{seed}")
    shutil.rmtree(folder, ignore_errors=True)
    env = make_vec_env("CartPole-v1", n_envs=8, seed=seed)
    agent = PPO("MlpPolicy", env, n_steps=128, gamma=0.98, seed=seed, device="cpu")
    agent.learn(TRAINING_STEPS)

    print("FIND")
    run = find(agent, folder / "before", seed)
    print("\nUNDERSTAND", textwrap.fill(run.diagnosis.sentence, 80), sep="\n")
    fixed = fix(agent, run, seed + 1)
    fixed.save(folder / "fixed.zip")
    suite = export(run, folder / "suite", application=make_application(agent))
    result = regress(suite.path, make_application(fixed), require_fixed=0.5)
    known = [world.change for world in result.worlds if world.case.objective == "failure"]
    broke = sum(world.change in ("new failure", "regressed") for world in result.worlds)
    print(f"\nFIX AND GUARD\n{known.count('fixed')} of {len(known)} known failures are fixed.")
    print(f"{broke} of {len(result.worlds)} worlds broke: {result.decision.status}.")
    draw({"before": agent, "after": fixed}, folder / "before-after.png")
    print("\nFIND AGAIN")
    find(fixed, folder / "after", seed + 100)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
