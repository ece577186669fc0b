"""What a driver did: on which routes it failed, at which turn, on which side, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingEnd, DrivingEpisodes, DrivingStart
from sada_gym.envs.driving.world.route import COMMAND_LEAD_M, COMMANDS, SPACING_M, Route
from sada_gym.envs.episodes.base import Rollout
from sada_gym.foundations.behaviour import Behaviour, listed_events

_BEND_M, _BEND_RAD = 8.0, np.deg2rad(20.0)
"""A street bends where its heading changes by more than this within so far before and after."""


def behaviour(episodes: DrivingEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the drives in some rows, those of one world, have ended."""
    drives, events = [], []
    for number, i in enumerate(rows, 1):
        route, ending = episodes.starts[i].route, DrivingEnd(int(episodes.ending[i]))
        made_m, after_s = float(episodes.progress_m[i]), float(episodes.steps[i] / POLICY_HZ)
        where = place_on(route, made_m)
        drives.append(
            {"route": number, "ending": ending.name.lower(), "where": where}
            | {"driven_m": round(made_m, 1), "after_s": after_s}
        )
        if ending == DrivingEnd.LEFT_LANE:
            side = "right" if episodes.lateral_m[i] > 0 else "left"
            drives[-1]["side"] = side
            words = f"route {number}: left its lane on the {side} {where} after {after_s:.1f} s"
            events.append((words, f"left its lane {where}"))
        elif ending != DrivingEnd.ARRIVED:
            events.append((f"route {number}: not there after {after_s:.0f} s", "not there in time"))
    text, told = listed_events(events, len(rows), "drive", f"all {len(rows)} drives arrived")
    return Behaviour(text, told, "drive", {"drives": drives})


def ending(rollout: Rollout[DrivingStart]) -> tuple[str, int]:
    """Say how a drive ended, and at which step."""
    after_s = rollout.last / POLICY_HZ
    texts = {
        DrivingEnd.ARRIVED: f"arrived after {after_s:.0f} s",
        DrivingEnd.LEFT_LANE: f"left its lane on the {_side(rollout)} after {after_s:.1f} s",
        DrivingEnd.TOO_LATE: f"not there after {after_s:.0f} s",
    }
    return texts[DrivingEnd(int(rollout["ending"][-1]))], rollout.last


def _side(rollout: Rollout[DrivingStart]) -> str:
    # y points to the right of x
    route, place = rollout.start.route, rollout["states"][-1, :2]
    off = place - route.points
    nearest = int((off**2).sum(axis=1).argmin())
    heading = route.heading[nearest]
    right = -np.sin(heading) * off[nearest, 0] + np.cos(heading) * off[nearest, 1]
    return "right" if right > 0 else "left"


def place_on(route: Route, made_m: float) -> str:
    """Say where on a route a car is: in which turn, bend or crossing."""
    last = len(route.points) - 1
    at = min(int(made_m / SPACING_M), last)
    turned = _turned(route, at)
    command = COMMANDS[route.command[at]]
    if command == "straight":
        return "at a crossing"
    if command != "follow":
        return f"{'in' if turned else 'before'} a {command} turn"
    behind = route.command[max(0, at - round(COMMAND_LEAD_M / SPACING_M)) : at]
    if turns := [COMMANDS[code] for code in behind if COMMANDS[code] in ("left", "right")]:
        return f"after a {turns[-1]} turn"
    if turned:
        return f"in a bend to the {'right' if turned > 0 else 'left'}"
    return "on a straight street"


def _turned(route: Route, at: int) -> int:
    """Say whether the road turns there: 1 to the right, -1 to the left, 0 hardly."""
    reach = round(_BEND_M / SPACING_M)
    around = route.heading[max(0, at - reach) : at + reach + 1]
    turn = float(around[-1] - around[0])  # y points to the right of x
    return int(np.sign(turn)) if abs(turn) > _BEND_RAD else 0
