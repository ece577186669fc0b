"""What it costs that an agent runs in a process of its own."""

from __future__ import annotations

import sys
import time
from contextlib import closing

import numpy as np
import pytest
from stable_baselines3 import PPO

from sada_gym import GymnasiumApplication

CALLS = 5


@pytest.mark.parametrize("worlds", [16, 64])
def test_an_agent_in_its_own_process_costs_little(worlds, tmp_path, record_property):
    """An SB3 policy balances poles in `worlds` worlds in lockstep, 16 in one call of its network.

    The ratio should be at most 1.3; a message for 16 worlds carries least, and costs relatively
    most.
    """
    PPO("MlpPolicy", "CartPole-v1", seed=0, device="cpu").learn(4_096).save(tmp_path / "agent.zip")
    (tmp_path / "serve.py").write_text(
        f"import sada_gym\nsada_gym.serve({str(tmp_path / 'agent.zip')!r})\n"
    )
    here, there = (
        GymnasiumApplication(
            "CartPole-v1",
            agent=agent,
            parameters={"force_mag": (8.0, 12.0)},
            score=("length", 500),
            fooling_threshold=0.5,
        )
        for agent in (tmp_path / "agent.zip", [sys.executable, str(tmp_path / "serve.py")])
    )
    mu, times = np.zeros((worlds, 1)), {}
    with closing(there):
        for application in (here, there) * CALLS:
            began = time.perf_counter()
            scores = application.evaluate(mu, range(worlds)).score
            times.setdefault(application, []).append(time.perf_counter() - began)
            assert (scores == here.evaluate(mu[:1], [0]).score[0]).sum() >= 1
    ratio = min(times[there]) / min(times[here])
    record_property("ratio", ratio)
    print(f"\n{worlds} worlds: {ratio:.2f} times as long as in one process")
