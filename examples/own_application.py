"""An application of your own: in which worlds does an emergency brake come too late?

Run it:             python examples/own_application.py
Check its contract: sada-gym check examples/own_application.py

The world is no Gymnasium environment: it is a few equations, and NumPy solves them for all worlds
of a batch at once. A thousand worlds take less than a second.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import gymnasium as gym
import numpy as np

from sada_gym import Application, Oracle, Parameter, ParameterSpace, Scored, adversaries
from sada_gym.envs import AdversaryEnv
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.parameters import Mu

STEPS, STEP_S = 1_000, 0.02
DISTANCE_M = 60.0  # to a standing car, when the radar first sees it
RADAR_NOISE_M = 0.5  # standard deviation
BRAKES_N, CAR_KG, G_M_S2 = 12_000.0, 1_400.0, 9.81


class EmergencyBrake:
    """The agent under test: brakes as soon as stopping in time needs more than 6 m/s²."""

    limits = np.array([6.0, 2.0])  # deceleration in m/s², distance left when standing in m

    def __call__(self, distance_m: np.ndarray, speed_m_s: np.ndarray) -> np.ndarray:
        """Return whether each car brakes, (n,)."""
        needed, left = self.limits
        return speed_m_s**2 > 2.0 * needed * (distance_m - left)


class Braking(Application):
    """Q is the share of the car's kinetic energy that is gone before it hits anything."""

    name = "Braking"
    version = 0  # raise it when a score changes
    fooling_threshold = 0.75  # it hits the other car at half its speed or faster
    sample_size = 100
    parameters = ParameterSpace(
        Parameter("speed_m_s", 10.0, 30.0, "m/s"),
        Parameter("friction", 0.2, 1.0),
        Parameter("slope", -10.0, 10.0, "%"),  # below zero is downhill
        Parameter("load_kg", 0.0, 800.0, "kg"),
    )

    def __init__(self) -> None:
        self.agent = EmergencyBrake()

    @property
    def fingerprint(self) -> str:
        """What scores in a store belong to: other limits, other scores."""
        return hashlib.sha256(self.agent.limits.tobytes()).hexdigest()

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        first_speed, friction, slope, load = self.parameters.physical(mu).T
        brakes = np.minimum(BRAKES_N / (CAR_KG + load), friction * G_M_S2)
        deceleration = brakes + slope / 100.0 * G_M_S2
        # all randomness comes from the evaluation's own seed
        noise = [np.random.default_rng(seed).normal(0.0, RADAR_NOISE_M, STEPS) for seed in seeds]
        speed, distance = first_speed.copy(), np.full(len(mu), DISTANCE_M)
        braking = np.zeros(len(mu), bool)
        for error in np.transpose(noise):
            braking |= self.agent(distance + error, speed)
            going = distance > 0.0
            speed = np.where(braking & going, speed - deceleration * STEP_S, speed).clip(0.0)
            distance -= np.where(going, speed * STEP_S, 0.0)
        score = 1.0 - (speed / first_speed) ** 2
        return Scored(score, [{"impact_m_s": float(one)} for one in speed])


# the application as a Gymnasium environment: the action is mu, the reward is -Q
gym.register("Braking-v0", entry_point=AdversaryEnv, kwargs={"application": Braking})


def main() -> None:
    """Attack it, and say where it fails."""
    adversary = adversaries.make("bbgan", dimension=4, seed=0)
    with Oracle("Braking-v0", budget=1_000, seed=0) as oracle:
        adversary.train(oracle)
    mu = adversary.sample(100)
    with Oracle("Braking-v0", budget=100, seed=0, stream="test") as test:
        print(f"attack fooling rate: {attack_fooling_rate(test(mu), test.threshold)}")
    for name, value in Braking.parameters.describe(np.median(mu, axis=0)).items():
        print(f"{name}: median {value:.2f}")


if __name__ == "__main__":
    main()
