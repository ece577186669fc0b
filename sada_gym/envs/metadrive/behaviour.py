"""What became of a drive: whether it arrived, or what it hit or left, where, and how fast."""

from __future__ import annotations

from collections.abc import Sequence

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.envs.metadrive.start import POLICY_HZ, DriveEnd, DriveStart
from sada_gym.foundations.behaviour import Behaviour


def behaviour(drives: DriveEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the drive of one world has ended."""
    (i,) = rows
    info, end = drives.info(i), DriveEnd(int(drives.ending[i]))
    events = () if end == DriveEnd.ARRIVED else (end.words,)
    text = _said(end, info["after_s"], info["route_done"], info["speed_km_h"])
    return Behaviour(text, events, data=info)


def ending(rollout: Rollout[DriveStart]) -> tuple[str, int]:
    """Say how a drive ended, and at which step."""
    end, speed = DriveEnd(int(rollout["ending"][-1])), float(rollout["pose"][-1, 3])
    return _said(end, rollout.last / POLICY_HZ, float(rollout["done"][-1]), speed), rollout.last


def _said(end: DriveEnd, after_s: float, done: float, speed_km_h: float) -> str:
    text = f"{end.words} after {after_s:.1f} s"
    if end == DriveEnd.ARRIVED:
        return text
    return f"{text} and {min(done, 1.0):.0%} of the route, at {speed_km_h:.0f} km/h"
