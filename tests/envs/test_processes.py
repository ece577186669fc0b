"""Environments in other processes: Gymnasium's and SB3's, by fork, forkserver and spawn.

Each case runs in an interpreter of its own: a fork depends on what its process has done before.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

LIMIT_S = 240
"""A hang fails the test by then. A slow machine needs most of it to compile kernels once."""

PROGRAM = """
import sys
import gymnasium as gym
import numpy as np
import sada_gym

ENV_ID, CLIENT, METHOD, BEFORE = sys.argv[1:]


def make():
    return gym.make(ENV_ID)


def main():
    if BEFORE == "used":
        import torch

        torch.ones(500, 500) @ torch.ones(500, 500)  # in all of torch's threads
        env = gym.make(ENV_ID, render_mode="rgb_array")
        env.reset(seed=3)
        env.step(np.zeros(env.action_space.shape, np.float32))
        env.render()
    method = None if METHOD == "default" else METHOD
    if CLIENT == "gymnasium":
        envs = gym.make_vec(
            ENV_ID,
            num_envs=2,
            vectorization_mode="async",
            vector_kwargs={"context": method, "autoreset_mode": "SameStep"},
        )
        envs.reset(seed=3)
    else:
        from stable_baselines3.common.vec_env import SubprocVecEnv

        envs = SubprocVecEnv([make] * 2, start_method=method)
        envs.seed(3)
        envs.reset()
    actions = np.zeros((2, *gym.make(ENV_ID).action_space.shape), np.float32)
    rewards = envs.step(actions)[1]
    envs.close()
    expected = sada_gym.make_application(ENV_ID).evaluate(actions, [3, 4]).score
    assert np.array_equal(np.float32(rewards), np.float32(-expected)), (rewards, expected)
    print("agreed")


if __name__ == "__main__":
    main()
"""

IDS = ("SADA-Detection-Car-v0", "SADA-Driving-Straight-v0", "SADA-UAV-3Anchors-v0")
DETECTION, DRIVING, RACING = IDS
FAST = {
    (DRIVING, "gymnasium", "default", "used"),
    (RACING, "gymnasium", "default", "fresh"),
    (DETECTION, "sb3", "default", "used"),
}
ALL = [
    *((env_id, "gymnasium", "default", before) for env_id in IDS for before in ("fresh", "used")),
    *((env_id, "sb3", "default", "used") for env_id in IDS),
    (DETECTION, "gymnasium", "spawn", "used"),
    (DETECTION, "sb3", "fork", "used"),
    (DETECTION, "sb3", "spawn", "fresh"),
]
CASES = [pytest.param(*case, marks=() if case in FAST else pytest.mark.slow) for case in ALL]


def users_environment() -> dict[str, str]:
    """Return the environment without the tests' one thread a process, which would hide a hang."""
    return {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}


@pytest.mark.long
@pytest.mark.parametrize(("env_id", "client", "method", "before"), CASES)
def test_it_works_in_other_processes(
    env_id: str, client: str, method: str, before: str, tmp_path: Path
) -> None:
    if method == "fork" and sys.platform != "linux":
        pytest.skip("a fork is no default here")
    program = tmp_path / "program.py"
    program.write_text(PROGRAM, encoding="utf-8")
    command = [sys.executable, str(program), env_id, client, method, before]
    done = subprocess.run(
        command,
        env=users_environment(),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        start_new_session=True,
        check=False,
    )
    assert done.stdout.strip().endswith("agreed"), done.stdout + done.stderr


@pytest.mark.long
def test_a_fork_has_one_thread_of_torch_and_its_parent_keeps_its_own() -> None:
    program = (
        "import os, sys, torch, sada_gym.foundations.determinism\n"
        "torch.set_num_threads(2)\n"
        "torch.ones(500, 500) @ torch.ones(500, 500)\n"
        "child = os.fork()\n"
        "if not child:\n"
        "    torch.ones(500, 500) @ torch.ones(500, 500)\n"
        "    os._exit(torch.get_num_threads())\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), torch.get_num_threads())\n"
    )
    if not hasattr(sys.modules["os"], "fork"):
        pytest.skip("no fork here")
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=users_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout.split() == ["1", "2"], done.stderr
