"""What a pilot did: whether it followed, strayed, tumbled, sank or got lost, and when."""

from __future__ import annotations

from collections.abc import Sequence

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.quadrotor.episodes import QuadrotorEpisodes
from sada_gym.envs.quadrotor.start import POLICY_HZ, FlightEnd, QuadrotorStart
from sada_gym.envs.quadrotor.world.dynamics import BOUND_M, LOST_M
from sada_gym.foundations.behaviour import Behaviour

SHAKING_RAD_S = 4.0
"""A quadrotor shakes that turns about its axes faster than this on average. The figure of eight
alone asks for less than 1 rad/s."""


def behaviour(flights: QuadrotorEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the flight of one world has ended."""
    (i,) = rows
    info, score, shaking = flights.info(i), float(flights.score[i]), ""
    event, text = _early_end(int(flights.told[i, 5]), info["flown_s"], flights.told[i, 4])
    if not text:
        rate = info["turning_rad_s"]
        shaking = f", shaking at {rate:.0f} rad/s" if rate > SHAKING_RAD_S else ""
        text = f"{_share(score)}, at most {info['far_m']:.2f} m away{shaking}"
        event = "shook and strayed" if shaking else "strayed"
    return Behaviour(text, (event,) if score < 1.0 else (), data=info)


def ending(rollout: Rollout[QuadrotorStart]) -> tuple[str, int]:
    """Say how a flight ended, and at which step."""
    *_, upset, end = rollout["told"][-1].tolist()
    _, text = _early_end(int(end), rollout.last / POLICY_HZ, upset)
    return text or _share(rollout.score), rollout.last


def _share(score: float) -> str:
    return f"within {BOUND_M:g} m for {score:.0%} of the time"


def _early_end(end: int, after_s: float, upset: float) -> tuple[str, str]:
    """Say how a flight ended before its time: as an event and in full; empty where it did not."""
    tumbled = f"upside down after {upset / POLICY_HZ:.1f} s, " if upset else ""
    if end == FlightEnd.CRASHED:
        event = "tumbled to the ground" if upset else "sank to the ground"
        return event, f"{tumbled}hit the ground after {after_s:.1f} s"
    if end == FlightEnd.LOST:
        event = "tumbled away" if upset else "flew off"
        return event, f"{tumbled}{LOST_M:g} m off course after {after_s:.1f} s"
    return "", ""
