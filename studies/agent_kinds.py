"""Which kinds of agents are attacked, and whether their scores are pure: the table of a page.

    python -m studies.agent_kinds

Each agent acts in a CartPole or a Pendulum. Most have random weights: what they have learnt does
not matter here. "Pure" means that all scores are the same to the last bit in another batch, another
order and another process. The script ends with an error at the first agent whose scores are not.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import stable_baselines3
import torch

from sada_gym import GymnasiumApplication
from sada_gym.testing.purity import assert_pure

POLE = {
    "environment": "CartPole-v1",
    "parameters": {"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
    "derived": {"polemass_length": "masspole * length"},
    "score": ("length", 100),
    "max_steps": 100,
}
PENDULUM = {
    "environment": "Pendulum-v1",
    "parameters": {"g": (5.0, 15.0), "m": (0.5, 2.0)},
    "score": ("return", -1_700.0, 0.0),
    "max_steps": 60,
}


class Masked(gym.Wrapper):
    """A CartPole in which both actions are always valid."""

    def __init__(self, gravity: float = 9.8) -> None:
        super().__init__(gym.make("CartPole-v1"))
        self.unwrapped.gravity = gravity

    def action_masks(self) -> Any:
        """Return which actions are valid."""
        return np.ones(2, np.bool_)


class Remembers:
    """Balances, and does the other thing at every third step."""

    def __init__(self) -> None:
        self.steps = 0

    def __call__(self, seen: Any) -> int:
        """Choose an action."""
        self.steps += 1
        return int((seen[2] + seen[3] > 0.0) == bool(self.steps % 3))


def balance(seen: Any) -> int:
    """Choose an action for one observation."""
    return int(seen[2] + seen[3] > 0.0)


def kinds(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of each kind, and the arguments of its application."""
    for name in ("PPO", "A2C", "DQN"):
        yield name, {**POLE, "agent": model(stable_baselines3, name, "CartPole-v1")}
    for name in ("SAC", "TD3", "DDPG"):
        yield name, {**PENDULUM, "agent": model(stable_baselines3, name, "Pendulum-v1")}
    drawing = model(stable_baselines3, "PPO", "CartPole-v1")
    yield "PPO that draws its actions", {**POLE, "agent": drawing, "deterministic": False}
    yield from kinds_of_contrib(folder)
    yield "a function", {**POLE, "agent": balance}
    yield "a class, one agent an episode", {**POLE, "agent": Remembers}
    network = torch.nn.Sequential(torch.nn.Linear(4, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2))
    torch.jit.trace(network, torch.zeros(1, 4)).save(str(folder / "net.pt"))
    yield "a TorchScript file", {**POLE, "agent": folder / "net.pt"}
    try:
        torch.onnx.export(network, (torch.zeros(1, 4),), folder / "net.onnx", dynamo=False)
        yield "an ONNX file", {**POLE, "agent": folder / "net.onnx"}
    except ImportError:
        pass
    (folder / "serve.py").write_text(
        "import sada_gym\nsada_gym.serve(lambda seen: int(seen[2] + seen[3] > 0.0))\n"
    )
    command = [sys.executable, str(folder / "serve.py")]
    yield "a process of its own", {**POLE, "agent": command}


def kinds_of_contrib(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the kinds of sb3-contrib where it is installed, each out of its zip."""
    try:
        import sb3_contrib
    except ImportError:
        return
    for name in ("QRDQN", "ARS", "TRPO", "RecurrentPPO", "MaskablePPO", "TQC", "CrossQ"):
        base = PENDULUM if name in ("TQC", "CrossQ") else POLE
        policy = "MlpLstmPolicy" if name == "RecurrentPPO" else "MlpPolicy"
        model(sb3_contrib, name, str(base["environment"]), policy).save(folder / f"{name}.zip")
        more = {}
        if name == "MaskablePPO":
            more = {"environment": Masked, "parameters": {"gravity": (5.0, 20.0)}}
        yield f"{name}, a zip", {**base, "agent": folder / f"{name}.zip", **more}


def model(library: Any, name: str, env: str, policy: str = "MlpPolicy") -> Any:
    """Make a model with random weights."""
    return getattr(library, name)(policy, env, seed=0, device="cpu")


def main() -> None:
    """Print the table."""
    print("| agent | environment | pure |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in kinds(Path(folder)):
            application = GymnasiumApplication(
                **arguments, fooling_threshold=0.5, agent_id="of a kind"
            )
            with closing(application):
                assert_pure(application, n=5, sizes=(1, 3))
            print(f"| {name} | {application.name} | yes |", flush=True)


if __name__ == "__main__":
    main()
