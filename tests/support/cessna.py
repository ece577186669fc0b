"""The autopilot of JSBSim's Cessna 172 climbs and turns; nothing but its world is ours."""

from __future__ import annotations

import gymnasium as gym
import jsbsim
import numpy as np

jsbsim.FGJSBBase().debug_lvl = 0
START_FT, CLIMB_FT = 4_000.0, 300.0


class Cessna(gym.Env):
    """It flies for some half minutes; late steps near the altitude and heading count."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (4,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, render_mode=None):
        self.payload, self.turn, self.fdm = 180.0, 30.0, None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        fdm = self.fdm = jsbsim.FGFDMExec(jsbsim.get_default_root_dir())
        fdm.set_debug_level(0)
        fdm.load_model("c172x")
        fdm.set_dt(1 / 60)
        start = {"h-sl-ft": START_FT, "vc-kts": 100.0, "psi-true-deg": 90.0, "lat-gc-deg": 40.0}
        for name, value in start.items():
            fdm[f"ic/{name}"] = value
        fdm["inertia/pointmass-weight-lbs[2]"] = self.payload
        fdm["simulation/randomseed"] = int(self.np_random.integers(1, 30_000))
        fdm.run_ic()
        fdm["propulsion/set-running"] = -1
        fdm["fcs/throttle-cmd-norm"], fdm["fcs/mixture-cmd-norm"] = 0.78, 0.85
        fdm["ap/altitude_setpoint"], fdm["ap/altitude_hold"] = START_FT + CLIMB_FT, 1
        fdm["guidance/specified-heading-rad"] = np.radians(90.0 + self.turn)
        fdm["guidance/heading-selector-switch"] = fdm["ap/autopilot-roll-on"] = 1
        fdm["ap/roll-attitude-mode"] = 1
        self.steps = 0
        return self.seen(), {}

    def seen(self):
        names = ("position/h-sl-ft", "velocities/vc-kts", "attitude/phi-rad", "attitude/psi-rad")
        return np.array([self.fdm[name] for name in names], np.float32)

    def step(self, action):
        for _ in range(30):
            self.fdm.run()
        self.steps += 1
        seen = self.seen()
        near = np.clip(1 - abs(float(seen[0]) - START_FT - CLIMB_FT) / 400, 0, 1)
        reward = float(near) if self.steps > 40 else 0.0
        return seen, reward, bool(abs(seen[2]) > 1.0), False, {}
