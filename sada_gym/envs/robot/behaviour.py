"""What a robot did: on which trips it touched something, and what, or how far it came."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.robot.episodes import RobotEpisodes
from sada_gym.envs.robot.start import POLICY_HZ, RobotEnd, RobotStart
from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import Behaviour, listed_events


def behaviour(episodes: RobotEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the trips in some rows, those of one world, have ended."""
    trips, events = [], []
    for number, i in enumerate(rows, 1):
        ending, after_s = RobotEnd(int(episodes.ending[i])), float(episodes.steps[i] / POLICY_HZ)
        left_m = float(episodes.remaining_m[i])
        trips.append(
            {"trip": number, "ending": ending.name.lower(), "after_s": after_s}
            | {"remaining_m": round(left_m, 2)}
        )
        if ending == RobotEnd.COLLIDED:
            thing = touched(episodes.starts[i], episodes.poses[i], episodes.carts[i])
            trips[-1]["touched"] = thing
            events.append((f"trip {number}: hit {thing} after {after_s:.1f} s", f"hit {thing}"))
        elif ending != RobotEnd.ARRIVED:
            words = f"trip {number}: {left_m:.1f} m left after {after_s:.0f} s"
            events.append((words, "not there in time"))
    text, told = listed_events(events, len(rows), "trip", f"all {len(rows)} trips arrived")
    return Behaviour(text, told, "trip", {"trips": trips})


def ending(rollout: Rollout[RobotStart]) -> tuple[str, int]:
    """Say how a trip ended, and at which step."""
    last, pose = rollout.last, rollout["poses"][-1]
    after_s = last / POLICY_HZ
    end = RobotEnd(int(rollout["ending"][-1]))
    if end == RobotEnd.COLLIDED:
        hit = touched(rollout.start, pose, rollout["carts"][-1])
        return f"hit {hit} after {after_s:.1f} s", last
    if end == RobotEnd.ARRIVED:
        return f"arrived after {after_s:.0f} s", last
    away_m = math.dist(pose[:2], rollout.start.plan.ways[rollout.start.trip][-1])
    return f"too late: {away_m:.1f} m from its goal after {after_s:.0f} s", last


def touched(start: RobotStart, pose: Floats, carts: Floats) -> str:
    """Say what a robot with this pose, (3,), touches; `carts`, (CARTS, 2), are where carts are."""
    plan, (x, y, _) = start.plan, pose
    barrels = plan.barrels[: start.conditions.barrels]
    carts = carts[: len(plan.lanes)]
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
