"""Trips as shots: the hall from above, with the robot and what its lidar returned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import ImageDraw

from sada_gym.clips.captions import ring
from sada_gym.clips.shots import Clip, Shot, ShotEnding, clip_failures, describe_world, steps_before
from sada_gym.envs.episodes.rollout import Rollout
from sada_gym.envs.robot.behaviour import touched
from sada_gym.envs.robot.frame import WIDTH, snapshot
from sada_gym.envs.robot.start import POLICY_HZ, RobotEnd, RobotStart
from sada_gym.envs.robot.world.floor_plan import HALL_M
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from sada_gym.envs.robot.application import RobotApplication

FASTER = 2
"""A trip is shown so many times faster: the robot drives at 0.6 m/s."""


def clip(application: RobotApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the trips that failed ended."""
    rollouts = application.rollouts(mu, seed)
    world = describe_world(application, mu)

    def shot(i: int, seconds: float) -> Shot:
        return _shot(rollouts[i], f"trip {i + 1} of {len(rollouts)}", world, seconds)

    score = np.array([rollout.score for rollout in rollouts])
    return clip_failures(score, score < 1, seconds, shot)


def _shot(rollout: Rollout[RobotStart], name: str, world: str, seconds: float) -> Shot:
    last = len(rollout["poses"]) - 1
    steps = steps_before(last, seconds * FASTER * POLICY_HZ)
    ending = RobotEnd(int(rollout["ending"][-1]))
    pictures = [snapshot(rollout, step) for step in steps]
    if ending != RobotEnd.ARRIVED:
        unit, (x, y, _) = WIDTH / HALL_M[0], rollout["poses"][-1]
        ring(ImageDraw.Draw(pictures[-1]), x * unit, (HALL_M[1] - y) * unit, 28)
    notes = [f"{name}  ·  {step / POLICY_HZ:.1f} s  ·  twice as fast" for step in steps]
    after_s = last / POLICY_HZ
    goal = rollout.start.plan.ways[rollout.start.trip][-1]
    away_m = float(np.hypot(*(rollout["poses"][-1, :2] - goal)))
    hit = touched(rollout.start, rollout["poses"][-1], rollout["carts"][-1])
    texts = {
        RobotEnd.ARRIVED: f"arrived after {after_s:.0f} s",
        RobotEnd.TOO_LATE: f"too late: {away_m:.1f} m from its goal after {after_s:.0f} s",
        RobotEnd.COLLIDED: f"hit {hit} after {after_s:.1f} s",
    }
    shot_ending = ShotEnding(texts[ending], ending != RobotEnd.ARRIVED)
    return Shot(pictures, FASTER * POLICY_HZ, notes, world, shot_ending)
