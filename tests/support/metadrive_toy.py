"""MetaDrive without its assets and pictures: one engine a process, its own IDM at the wheel."""

from __future__ import annotations

import gymnasium as gym
from metadrive import MetaDriveEnv
from metadrive.engine.base_engine import BaseEngine
from metadrive.policy.idm_policy import IDMPolicy

from sada_gym import GymnasiumApplication

BaseEngine.try_pull_asset = staticmethod(lambda: None)  # physics needs no textures


class Drive(gym.Env):
    """A car follows a short road among others; the world follows from the seed of the reset."""

    def __init__(self, render_mode=None, traffic_density=0.1, lane_width=3.5, idm=False):
        road = {"type": "block_num", "config": 1, "lane_width": lane_width, "lane_num": 2}
        settings = {
            "use_render": False,
            "num_scenarios": 1000,
            "start_seed": 0,
            "log_level": 50,
            "traffic_density": float(traffic_density),
            "map_config": road,
        }
        self.drive = MetaDriveEnv({**settings, **({"agent_policy": IDMPolicy} if idm else {})})
        self.observation_space = self.drive.observation_space
        self.action_space = self.drive.action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, _ = self.drive.reset(seed=int(self.np_random.integers(1000)))
        return observation, {}

    def step(self, action):
        observation, reward, terminated, truncated, info = self.drive.step(action)
        told = {"arrived": bool(info["arrive_dest"]), "crash": bool(info["crash"])}
        return observation, float(reward), bool(terminated), bool(truncated), told

    def close(self):
        self.drive.close()


def straight(seen):
    return [0.0, 0.3]


def driving(**kwargs):
    settings = {
        "agent": straight,
        "agent_id": "straight",
        "parameters": {"traffic_density": (0.0, 0.3), "lane_width": (3.0, 4.0)},
        "score": ("return", -10.0, 60.0),
        "fooling_threshold": 0.5,
        "max_steps": 30,
    }
    return GymnasiumApplication(Drive, **{**settings, **kwargs})
