"""Whether `sada-gym estimate` holds on agents: beside many plain draws of ordinary use.

    python -m studies.agents_in_use [NAME ...]

Each under densities that are examples: 2,000 queries, and 3,000 to 20,000 plain draws. In brackets:
95 % intervals. Each takes 2 to 25 minutes of a core.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from sada_gym import Application, GymnasiumApplication, estimate, make_application
from sada_gym.densities import Density, WorldDensity
from sada_gym.envs.wrapped import ActionDelay, ObservationNoise
from studies.shares import share

AT_ONCE, SEED = 500, 0
_BUILT = {"mass_ratio": (1.0, 0.05), "arm_ratio": (1.0, 0.02), "torque_to_inertia": (463.0, 40.0)}
_FLOWN = {"delay_s": (0.003, 0.001), "wind_m_s": (1.0, 1.0), "speed_m_s": (0.8, 0.3)}
NORMAL: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "SADA-Digits-3-v0": {
        **{"rotation_deg": (0.0, 8.0), "scale": (1.0, 0.05), "shear": (0.0, 0.06)},
        **{"shift_px": (0.0, 0.3), "contrast": (1.0, 0.1), "stroke": (0.0, 0.3)},
    },
    "SADA-Quadrotor-Crazyflie-v0": {**_BUILT, **_FLOWN, "thrust_to_weight": (2.0, 0.1)},
    "CartPole": {
        **{"gravity": (9.8, 0.1), "force_mag": (10.0, 1.0), "length": (0.5, 0.1)},
        **{"masspole": (0.1, 0.02), "delay": (0.3, 0.6), "noise": (0.02, 0.02)},
    },
    "SADA-Robot-Warehouse-v0": {
        **{
            "floor_friction": (0.25, 0.03),
            "payload_kg": (1.0, 0.5),
            "payload_offset_m": (0.0, 0.02),
        },
        **{
            "lidar_yaw_deg": (0.0, 5.0),
            "lidar_offset_m": (0.0, 0.02),
            "lidar_noise_m": (0.02, 0.02),
        },
        **{"lidar_dropout": (0.05, 0.1), "wheel_gain": (0.0, 0.03), "latency_s": (0.05, 0.05)},
        "obstacle_density": (1.0, 0.3),
    },
    "SADA-Driving-Straight-v0": {"camera_height_m": (1.5, 0.1), "camera_pitch_deg": (-15.0, 1.0)},
    "SADA-DetectionCoco-Motorbike-v0": {
        "camera_distance": (10.0, 1.0),
        "camera_pitch_deg": (5.0, 5.0),
        "light_pitch_deg": (45.0, 10.0),
    },
    "LunarLander": {"gravity": (-10.0, 0.5), "wind_power": (2.0, 2.0), "noise": (0.01, 0.01)},
}
"""Mean and standard deviation of the parameters' normal densities; the others are uniform."""
DRAWS: Mapping[str, int] = {
    "LunarLander": 5_000,
    "SADA-Robot-Warehouse-v0": 5_000,
    "SADA-Driving-Straight-v0": 3_000,
    "SADA-DetectionCoco-Motorbike-v0": 5_000,
}
_USUAL_DRAWS = 20_000


def balance(seen: Any) -> int:
    """Push the cart towards the side to which the pole falls."""
    return int(seen[2] + 0.5 * seen[3] + 0.02 * seen[0] + 0.1 * seen[1] > 0)


def land(seen: Any) -> int:
    """Land as Gymnasium's own heuristic does."""
    from types import SimpleNamespace

    from gymnasium.envs.box2d.lunar_lander import heuristic

    engines = SimpleNamespace(unwrapped=SimpleNamespace(continuous=False))
    return int(heuristic(engines, [*seen[:6], seen[6] > 0.5, seen[7] > 0.5]))  # noisy, too


def made(name: str) -> Application:
    """Return the application of an id, or one of Gymnasium's environments with a simple agent."""
    if name == "CartPole":
        return GymnasiumApplication(
            "CartPole-v1",
            agent=balance,
            agent_id="balance",
            parameters={
                "gravity": (5.0, 15.0),
                "force_mag": (5.0, 15.0),
                "length": (0.1, 1.5),
                "masspole": (0.02, 0.5),
                "delay": ActionDelay(0, 3),
                "noise": ObservationNoise(0.0, 0.1),
            },
            derived={
                "total_mass": "masspole + masscart",
                "polemass_length": "masspole * length",
            },
            score=("length", 500),
            fooling_threshold=0.9,
        )
    if name == "LunarLander":
        return GymnasiumApplication(
            "LunarLander-v3",
            agent=land,
            agent_id="heuristic",
            parameters={
                "gravity": (-11.9, -6.0),
                "wind_power": (0.0, 20.0),
                "noise": ObservationNoise(0.0, 0.1),
            },
            env_kwargs={"enable_wind": True},
            score=("return", -300.0, 300.0),
            fooling_threshold=0.5,
        )
    return make_application(name)


def plain(name: str, densities: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
    """Evaluate plain draws, and return which of them fool, (n,) bool."""
    application, draws = made(name), DRAWS.get(name, _USUAL_DRAWS)
    use = WorldDensity(application.parameters, {k: Density(v) for k, v in densities.items()})
    mu = use.sample(draws, np.random.default_rng(SEED + 1))
    seeds = np.arange(draws) + 10**6
    blocks = [slice(start, start + AT_ONCE) for start in range(0, draws, AT_ONCE)]
    return np.concatenate(
        [application.evaluate(mu[block], seeds[block].tolist()).fooled for block in blocks]
    )


def main() -> None:
    """Print a row for each agent."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", default=list(NORMAL))
    for name in parser.parse_args().names:
        densities = {key: {"normal": [*numbers]} for key, numbers in NORMAL[name].items()}
        found = estimate(made(name), budget=2_000, seed=SEED, density=densities)
        low, high = (100 * end for end in found.interval)
        told = f"{100 * found.probability:.2f} % ({low:.2f} to {high:.2f})"
        fooled = plain(name, densities)
        print(f"| {name} | {told} | {len(fooled):,} | {share(fooled)} |", flush=True)


if __name__ == "__main__":
    main()
