"""An application of your own: in which worlds does a frozen cart-pole controller drop the pole?

Run it:             python examples/own_application.py
Check its contract: sada-gym check examples/own_application.py
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
from gymnasium.envs.classic_control import CartPoleEnv

from sada_gym import Application, Parameter, ParameterSpace, Scored, adversaries
from sada_gym.envs import AdversaryEnv
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.oracle import Oracle
from sada_gym.parameters import Mu

STEPS = 200


class Controller:
    """The agent under test: pushes right where a weighted sum of the state is positive."""

    weights = np.array([0.05, 0.2, 1.0, 0.5])  # cart position, its speed, pole angle, its speed

    def __call__(self, state: np.ndarray) -> int:
        """Choose a push for one state."""
        return int(self.weights @ state > 0.0)


class Balancing(Application):
    """Q is the share of 200 steps for which the pole stays up."""

    name = "Balancing"
    version = 0  # raise it when a score changes
    fooling_threshold = 0.5
    sample_size = 100
    parameters = ParameterSpace(
        Parameter("gravity_m_s2", 1.0, 25.0, "m/s²"),
        Parameter("pole_half_length_m", 0.1, 2.0, "m"),
        Parameter("pole_mass_kg", 0.05, 2.0, "kg"),
        Parameter("push_n", 2.0, 20.0, "N"),
    )

    def __init__(self) -> None:
        self.agent = Controller()

    @property
    def fingerprint(self) -> str:
        """What scores in a store belong to: other weights, other scores."""
        return hashlib.sha256(self.agent.weights.tobytes()).hexdigest()

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        worlds = zip(self.parameters.physical(mu).tolist(), seeds, strict=True)
        steps = [self._episode(*world, seed) for world, seed in worlds]
        return Scored(np.array(steps) / STEPS, [{"steps": n} for n in steps])

    def _episode(
        self, gravity: float, half_length: float, mass: float, push: float, seed: int
    ) -> int:
        """Build the world, let the agent act to the end, and count its steps."""
        world = CartPoleEnv()
        world.gravity, world.length, world.force_mag = gravity, half_length, push
        world.masspole, world.total_mass = mass, mass + world.masscart
        world.polemass_length = mass * half_length
        state, _ = world.reset(seed=seed)  # all randomness comes from the evaluation's seed
        for step in range(STEPS):
            state, _, fallen, _, _ = world.step(self.agent(state))
            if fallen:
                return step
        return STEPS


# the application as a Gymnasium environment: the action is mu, the reward is -Q
gym.register("Balancing-v0", entry_point=AdversaryEnv, kwargs={"application": Balancing})


def main() -> None:
    """Attack it, and say where it fails."""
    adversary = adversaries.make("bbgan", dimension=4, seed=0)
    with Oracle("Balancing-v0", budget=1_000, seed=0) as oracle:
        adversary.train(oracle)
    mu = adversary.sample(100)
    with Oracle("Balancing-v0", budget=100, seed=0, stream="test") as test:
        print(f"attack fooling rate: {attack_fooling_rate(test(mu), test.threshold)}")
    for name, value in Balancing.parameters.describe(np.median(mu, axis=0)).items():
        print(f"{name}: median {value:.2f}")


if __name__ == "__main__":
    main()
