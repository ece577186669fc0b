"""What a pilot did: which gates it missed, and how."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.uav.episodes import GATE_LIMIT_S, RacingEpisodes, RacingStart
from sada_gym.envs.uav.world.gates import OUTER_WIDTH_M
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import MOST_NAMED, Behaviour

_REACH_M = 0.3


def behaviour(races: RacingEpisodes, rows: Sequence[int]) -> Behaviour:
    """Say how the races in some rows, those of one world, have ended."""
    gates, words = [], []
    for i in rows:
        for gate, code in enumerate(races.endings[i].tolist()):
            gates.append({"gate": gate + 1, "ending": GateOutcome(code).name.lower()})
            if code > GateOutcome.PASSED:
                words.append(missed(races.gates[i], gate, code, races.ended_at[i, gate]))
    data = {"gates": gates}
    if not words:
        time_s = float(races.time_s[rows[0]])
        return Behaviour(f"passed all {len(gates)} gates in {time_s:.1f} s", data=data)
    text = f"missed {len(words)} of {len(gates)} gates: {'; '.join(words[:MOST_NAMED])}"
    text += f"; and {more} more" if (more := len(words) - MOST_NAMED) > 0 else ""
    # a drone that was set back into a gate often misses the next ones, too: the first one counts
    return Behaviour(text, (f"{words[0]} first",), data=data)


def ending(rollout: Rollout[RacingStart]) -> tuple[str, int]:
    """Say how a race went wrong first, if at all, and the step at which that shows."""
    outcomes, gates = rollout["endings"], rollout.start.gates
    is_missed = outcomes > GateOutcome.PASSED
    if not is_missed.any():
        return f"all {len(gates)} gates in {rollout['time_s'][-1]:.1f} s", rollout.last
    step = int(is_missed.any(axis=1).argmax())
    gate = int(is_missed[step].argmax())
    return missed(gates, gate, int(outcomes[step, gate]), rollout["ended_at"][step, gate]), step


def missed(gates: Floats, gate: int, outcome: int, at: Floats) -> str:
    """Say how a gate, by its number from 0 among `gates` (g, 4), was missed; `at` (3,) is where."""
    away = np.hypot(*(gates[:, :2] - at[:2]).T)
    nearest = int(away.argmin())
    # a drone that touches a frame is no further from its middle than that
    if outcome == GateOutcome.HIT and away[nearest] < OUTER_WIDTH_M / 2 + _REACH_M:
        return f"hit the frame of gate {nearest + 1}"
    words = {
        GateOutcome.LATE: f"not through gate {gate + 1} in {GATE_LIMIT_S:.0f} s",
        GateOutcome.LOST: f"lost on the way to gate {gate + 1}",
        GateOutcome.HIT: f"hit the ground before gate {gate + 1}",
    }
    return words[GateOutcome(outcome)]
