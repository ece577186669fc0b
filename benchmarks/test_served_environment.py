"""What it costs that an environment runs in a process of its own."""

from __future__ import annotations

import importlib
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped.served import server_of

CALLS = 5
POLE = """
import time
from gymnasium.envs.classic_control import CartPoleEnv

class {name}(CartPoleEnv):
    def step(self, action):
        until = time.perf_counter() + {seconds}
        while time.perf_counter() < until:
            pass
        return super().step(action)
"""


@pytest.mark.parametrize(("name", "seconds"), [("Slow", 1e-3), ("Fast", 0.0)])
def test_an_environment_in_its_own_process_costs_little(
    name, seconds, tmp_path, monkeypatch, record_property
):
    """Sixteen poles in lockstep, whose step takes a millisecond: the ratio should be at most 1.5.

    A step that takes no time shows what a message costs.
    """
    module = f"{name.lower()}_pole"
    (tmp_path / f"{module}.py").write_text(POLE.format(name=name, seconds=seconds))
    monkeypatch.syspath_prepend(tmp_path)
    server = server_of([sys.executable, "serve_environment.py", f"{module}:{name}"], tmp_path)
    here, there = (
        GymnasiumApplication(
            environment,
            agent=lambda seen: int(seen[2] + seen[3] > 0),
            parameters={"force_mag": (8.0, 12.0)},
            score=("length", 50),
            max_steps=50,
            fooling_threshold=0.5,
            agent_id="by hand",
        )
        for environment in (getattr(importlib.import_module(module), name), server)
    )
    mu, times = np.zeros((16, 1)), {}
    with closing(there):
        for application in (here, there) * CALLS:
            began = time.perf_counter()
            scores = application.evaluate(mu, range(16)).score
            times.setdefault(application, []).append(time.perf_counter() - began)
            assert (scores == 1.0).all()
    one, other = min(times[here]), min(times[there])
    record_property("ratio", other / one)
    print(
        f"\na step of {1e6 * one / 800:.0f} us: {other / one:.2f} times as long as in this process"
    )
