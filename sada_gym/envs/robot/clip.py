"""Trips as shots: the hall from above, with the robot and what its lidar returned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import ImageDraw

from sada_gym.arrays import Floats
from sada_gym.clips.captions import ring
from sada_gym.clips.shots import Clip, Shot, ShotEnding, clip_failures, describe_world, steps_before
from sada_gym.envs.episodes.rollout import Rollout
from sada_gym.envs.robot.frame import WIDTH, snapshot
from sada_gym.envs.robot.start import POLICY_HZ, RobotEnd, RobotStart
from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M
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
    texts = {
        RobotEnd.ARRIVED: f"arrived after {after_s:.0f} s",
        RobotEnd.TOO_LATE: f"too late: {away_m:.1f} m from its goal after {after_s:.0f} s",
        RobotEnd.COLLIDED: f"hit {_hit(rollout)} after {after_s:.1f} s",
    }
    shot_ending = ShotEnding(texts[ending], ending != RobotEnd.ARRIVED)
    return Shot(pictures, FASTER * POLICY_HZ, notes, world, shot_ending)


def _hit(rollout: Rollout[RobotStart]) -> str:
    plan, (x, y, _) = rollout.start.plan, rollout["poses"][-1]
    barrels = plan.barrels[: rollout.start.conditions.barrels]
    carts = rollout["carts"][-1][: len(plan.lanes)]
    around = np.array([x, y])

    def round_ones(circles: Floats) -> float:
        away = np.hypot(*(circles[:, :2] - around).T) - circles[:, 2]
        return float(away.min(initial=np.inf))

    racks = plan.racks
    outside = np.maximum(np.maximum(racks[:, :2] - around, around - racks[:, 2:]), 0.0)
    walls = min(x, y, HALL_M[0] - x, HALL_M[1] - y)
    distances = {
        "a barrel": round_ones(barrels),
        "a pillar": round_ones(plan.pillars),
        "a cart": round_ones(np.column_stack([carts, np.full(len(carts), CART_RADIUS_M)])),
        "a rack": float(np.hypot(*outside.T).min(initial=np.inf)),
        "the wall": float(walls),
    }
    return min(distances, key=lambda name: distances[name])
