"""What a robot dog did: whether it walked its way, fell, slid, sank or strayed, and when."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.go2.episodes import Go2Episodes
from sada_gym.envs.go2.start import FOOLED, POLICY_HZ, Go2Start, WalkEnd
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import Behaviour

_LOW_M, _SLID_M, _ASTRAY_M = 0.17, 0.3, 0.5
"""A robot has sunk whose trunk is less above its feet, where 0.31 m is usual; it has slid back that
ends so far behind its start, and strayed that ends so far from its way."""
_CALVES, _CALF_M = (3, 6, 9, 12), 0.213


def behaviour(walks: Go2Episodes, rows: Sequence[int]) -> Behaviour:
    """Say how the walk of one world has ended."""
    (i,) = rows
    info, score = walks.info(i), float(walks.score[i])
    event, text = _told(walks.starts[i], walks.parts[i], walks.told[i], info["walked_s"])
    return Behaviour(text, (event,) if score <= FOOLED else (), data=info)


def ending(rollout: Rollout[Go2Start]) -> tuple[str, int]:
    """Say how a walk ended, and at which step."""
    last = rollout.last
    parts, told = rollout["parts"][-1], rollout["told"][-1]
    return _told(rollout.start, parts, told, last / POLICY_HZ)[1], last


def _told(start: Go2Start, parts: Floats, told: Floats, after_s: float) -> tuple[str, str]:
    """Say how a walk ended: as an event, and in full."""
    done, _, end = told.tolist()
    (x, y, z), trunk = parts[0, :3].tolist(), parts[0, 3:]
    if end == WalkEnd.BROKEN:
        return "broke", f"the simulation broke after {after_s:.1f} s"
    if end == WalkEnd.FELL:
        event = f"fell {_side(trunk)}"
        return event, f"{event} after {after_s:.1f} s, {done:.0%} of the way done"
    knees = parts[_CALVES, :]
    feet = knees[:, 2] - _CALF_M * (1 - 2 * (knees[:, 4] ** 2 + knees[:, 5] ** 2))
    away = math.sqrt(float(((start.way[:, :2] - [x, y]) ** 2).sum(axis=1).min()))
    event = "fell behind"
    if z - feet.min() < _LOW_M:
        event = "sank down"
    elif x < -_SLID_M and done < 0.05:
        event = "slid back"
    elif away > _ASTRAY_M:
        event = "strayed"
    text = f"{done:.0%} of the way done"
    return event, text if done > FOOLED else f"{event}: {text}"


def _side(trunk: Floats) -> str:
    """Say to which side a trunk has fallen: where down is, as it feels it."""
    w, x, y, z = trunk.tolist()
    turned = math.degrees(math.atan2(-(y * z + w * x), w * y - x * z))
    return ("forwards", "to the left", "backwards", "to the right")[round(turned / 90) % 4]
