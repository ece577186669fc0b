"""What became of a flight: stalled, upset, too fast, or so many feet and degrees off, and when."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.flight.episodes import FlightEpisodes
from sada_gym.envs.flight.start import (
    POLICY_HZ,
    WITHIN_DEG,
    WITHIN_FT,
    FlightEnd,
    FlightStart,
)
from sada_gym.envs.flight.world.engine import FIELDS
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import Behaviour


def behaviour(flights: FlightEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the flight of one world has ended."""
    (i,) = rows
    info, score = flights.info(i), float(flights.score[i])
    event, text = _early_end(int(flights.told[i, 3]), info["flown_s"], flights.states[i])
    if not text:
        far_ft, far_deg = info["altitude_error_ft"], info["heading_error_deg"]
        text = f"{_share(score)}; at most {far_ft:.0f} ft and {far_deg:.0f}° off"
        off = [("off altitude", far_ft > WITHIN_FT), ("off heading", far_deg > WITHIN_DEG)]
        event = " and ".join(name for name, is_off in off if is_off)
    return Behaviour(text, (event,) if event else (), data=info)


def ending(rollout: Rollout[FlightStart]) -> tuple[str, int]:
    """Say how a flight ended, and at which step."""
    end, state = int(rollout["told"][-1, 3]), rollout["states"][-1]
    _, text = _early_end(end, rollout.last / POLICY_HZ, state)
    return text or _share(rollout.score), rollout.last


def _share(score: float) -> str:
    return f"within {WITHIN_FT:.0f} ft and {WITHIN_DEG:.0f}° for {score:.0%} of the time"


def _early_end(end: int, after_s: float, state: Floats) -> tuple[str, str]:
    """Say how a flight ended before its time: as an event and in full; empty where it did not."""
    now = dict(zip(FIELDS, state.tolist(), strict=True))
    if end == FlightEnd.STALLED:
        angle = math.degrees(now["alpha_rad"])
        how = f"at {now['speed_kt']:.0f} kt, angle of attack {angle:.0f}°"
        return "stalled", f"stalled after {after_s:.0f} s {how}"
    if end == FlightEnd.UPSET:
        bank, pitch = now["bank_deg"], now["pitch_deg"]
        how = f"banked {abs(bank):.0f}°, nose {abs(pitch):.0f}° {'up' if pitch > 0 else 'down'}"
        return "upset", f"upset after {after_s:.0f} s: {how}, {now['speed_kt']:.0f} kt"
    if end == FlightEnd.OVERSPEED:
        return "too fast", f"{now['speed_kt']:.0f} kt after {after_s:.0f} s, beyond VNE"
    if end == FlightEnd.INVALID:
        return "invalid", "JSBSim could not compute the flight"
    return "", ""
