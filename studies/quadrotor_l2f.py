"""RAPTOR's authors' own simulator: a reference for ours, and RAPTOR with old observations there.

    python studies/quadrotor_l2f.py flights tests/envs/quadrotor/l2f.npz
    python studies/quadrotor_l2f.py delays

It runs where `l2f` 2.0.18 (PyPI, built from source in a minute), numpy and, for the delays,
`foundation-policy` 1.0.2 are installed. It needs nothing of this package, so that can be an
environment of its own. `flights` reads bodies and motors from the archive, as `dynamics.fly` takes
them, and writes flights back. `delays` hovers with the authors' policy, simulator and network code:
the share of 3 to 10 s within 0.3 m, with observations that are fresh and one step (10 ms) old.
"""

from __future__ import annotations

import json
import math
import sys

import numpy as np

STEPS, HOVERED, SETTLED, SEEDS = 100, 1_000, 200, 5
SIGNS = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], float)
CURVE = np.array([0.00352526, 0.01437313, 0.09223048])
TORQUES_TO_INERTIA = (100, 200, 400, 600, 900, 1200)


def airframe(base: str, body: np.ndarray, motors: np.ndarray) -> str:
    """Return l2f's parameters of a body (7,), without drag, and motors (4, 6)."""
    dynamics = json.loads(base)["dynamics"]
    mass, *inertia, rising, falling, _ = body.tolist()
    changed = {
        "mass": mass,
        "J": np.diag(inertia).tolist(),
        "J_inv": np.diag(1.0 / np.array(inertia)).tolist(),
        "rotor_positions": [[x, y, 0.0] for x, y in motors[:, :2].tolist()],
        "rotor_thrust_coefficients": motors[:, 3:].tolist(),
        "rotor_torque_constants": np.abs(motors[:, 2]).tolist(),
        "rotor_time_constants_rising": [rising] * 4,
        "rotor_time_constants_falling": [falling] * 4,
    }
    return json.dumps({**json.loads(base), "dynamics": {**dynamics, **changed}})


class Simulator:
    """One quadrotor in l2f, from hovering."""

    def __init__(self, body: np.ndarray, motors: np.ndarray) -> None:
        import l2f

        self._l2f, self._device, self._rng = l2f, l2f.Device(), l2f.Rng()
        self._env, self._parameters, self._next = l2f.Environment(), l2f.Parameters(), l2f.State()
        self.state = l2f.State()
        given = self._device, self._env
        l2f.initialize_environment(*given)
        l2f.initialize_rng(self._device, self._rng, 0)
        l2f.initial_parameters(*given, self._parameters)
        changed = airframe(l2f.parameters_to_json(*given, self._parameters), body, motors)
        l2f.parameters_from_json(*given, changed, self._parameters)
        l2f.initial_state(*given, self._parameters, self.state)
        self.state.rpm = [0.5] * 4

    def step(self, action: np.ndarray) -> None:
        """Fly for 10 ms."""
        given = self._device, self._env, self._parameters, self.state
        self._l2f.step(*given, action.astype(np.float32), self._next, self._rng)
        self.state.assign(self._next)

    def numbers(self) -> np.ndarray:
        """Return the state, (17,), as `dynamics` has it."""
        now = self.state
        parts = now.position, now.orientation, now.linear_velocity, now.angular_velocity, now.rpm
        return np.concatenate(parts)


def flights(path: str) -> None:
    """Fly each airframe of an archive with actions that change from step to step."""
    with np.load(path) as given:
        bodies, motors = given["bodies"], given["motors"]
    rng = np.random.default_rng(0)
    common = rng.normal(0.0, 0.25, (len(bodies), STEPS, 1))
    actions = common + rng.normal(0.0, 0.01, (len(bodies), STEPS, 4))
    actions = np.clip(actions, -1.0, 1.0).astype(np.float32)
    states = np.empty((len(bodies), STEPS + 1, 17), np.float32)
    for i, airframes in enumerate(zip(bodies, motors, strict=True)):
        simulator = Simulator(*airframes)
        states[i, 0] = simulator.numbers()
        for k in range(STEPS):
            simulator.step(actions[i, k])
            states[i, k + 1] = simulator.numbers()
    np.savez_compressed(path, bodies=bodies, motors=motors, actions=actions, states=states)


def rotation(w: float, x: float, y: float, z: float) -> list[float]:
    """Return a quaternion's matrix, row by row."""
    return [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]


def hovered(torque_to_inertia: float, delay: int, seed: int) -> float:
    """Return the share of the time that a Crazyflie in the middle of all ranges stays near."""
    from foundation_policy import Raptor

    mass, arm = 1.1 * 0.0306, 1.035 * 0.028
    most = 3.25 * mass * 9.81 / 4
    inertia = math.sqrt(2.0) * arm * most / torque_to_inertia
    motors = np.zeros((4, 6))
    motors[:, :3] = SIGNS * [arm, arm, 4.665e-3]
    motors[:, 3:] = CURVE * most / CURVE.sum()
    body = [mass, inertia, 1.0242 * inertia, 1.8541 * inertia, 0.065, 0.165, 0.0]
    simulator, policy = Simulator(np.array(body), motors), Raptor()
    simulator.state.position = np.random.default_rng(seed).uniform(-0.3, 0.3, 3)
    policy.reset()
    action, seen, near = np.zeros(4), [], 0
    for step in range(HOVERED):
        now = simulator.state
        parts = now.position, rotation(*now.orientation), now.linear_velocity, now.angular_velocity
        seen.append(np.concatenate(parts))
        observed = np.concatenate([seen[max(0, step - delay)], action])
        action = np.clip(policy.evaluate_step(observed[None])[0], -1.0, 1.0)
        simulator.step(action)
        near += step >= SETTLED and float((simulator.numbers()[:3] ** 2).sum()) <= 0.3**2
    return near / (HOVERED - SETTLED)


def main() -> None:
    if sys.argv[1:2] == ["flights"]:
        flights(sys.argv[2])
        return
    print("| delay |", " | ".join(f"{x} 1/s²" for x in TORQUES_TO_INERTIA), "|")
    for delay in (0, 1):
        means = (
            np.mean([hovered(torque, delay, seed) for seed in range(SEEDS)])
            for torque in TORQUES_TO_INERTIA
        )
        print(f"| {10 * delay} ms |", " | ".join(f"{mean:.2f}" for mean in means), "|")


if __name__ == "__main__":
    main()
