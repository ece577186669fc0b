"""Whether `sada-gym estimate` holds on agents: beside many plain draws of ordinary use.

    python -m studies.agents_in_use

A digit's classifier, and RAPTOR on a Crazyflie, under densities that are examples: 2,000 queries
each, and 20,000 plain draws. It takes about four core minutes. In brackets: 95 % intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sada_gym import estimate, make_application
from sada_gym.densities import Density, WorldDensity
from studies.shares import share

DRAWS, AT_ONCE, SEED = 20_000, 500, 0
_BUILT = {"mass_ratio": (1.0, 0.05), "arm_ratio": (1.0, 0.02), "torque_to_inertia": (463.0, 40.0)}
_FLOWN = {"delay_s": (0.003, 0.001), "wind_m_s": (1.0, 1.0), "speed_m_s": (0.8, 0.3)}
NORMAL: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "SADA-Digits-3-v0": {
        **{"rotation_deg": (0.0, 8.0), "scale": (1.0, 0.05), "shear": (0.0, 0.06)},
        **{"shift_px": (0.0, 0.3), "contrast": (1.0, 0.1), "stroke": (0.0, 0.3)},
    },
    "SADA-Quadrotor-Crazyflie-v0": {**_BUILT, **_FLOWN, "thrust_to_weight": (2.0, 0.1)},
}
"""Mean and standard deviation of the parameters' normal densities; the others are uniform."""


def plain(track: str, densities: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
    """Evaluate plain draws, and return which of them fool, (DRAWS,) bool."""
    application = make_application(track)
    use = WorldDensity(application.parameters, {k: Density(v) for k, v in densities.items()})
    mu = use.sample(DRAWS, np.random.default_rng(SEED + 1))
    seeds = np.arange(DRAWS) + 10**6
    blocks = [slice(start, start + AT_ONCE) for start in range(0, DRAWS, AT_ONCE)]
    return np.concatenate(
        [application.evaluate(mu[block], seeds[block].tolist()).fooled for block in blocks]
    )


def main() -> None:
    """Print a row for each agent."""
    for track, normal in NORMAL.items():
        densities = {name: {"normal": [*numbers]} for name, numbers in normal.items()}
        found = estimate(track, budget=2_000, seed=SEED, density=densities)
        low, high = (100 * end for end in found.interval)
        told = f"{100 * found.probability:.2f} % ({low:.2f} to {high:.2f})"
        print(f"| {track} | {told} | {share(plain(track, densities))} |", flush=True)


if __name__ == "__main__":
    main()
