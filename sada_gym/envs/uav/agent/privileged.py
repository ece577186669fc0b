"""The privileged pilot, which knows where the next gate is and flies there by the guidance.

It shows that a track can be flown, slowly if need be, and faster it is the expert that the
perception network imitates.
"""

from __future__ import annotations

from sada_gym.envs.uav.episodes import RacingEpisodes
from sada_gym.envs.uav.world.guidance import steer
from sada_gym.foundations.arrays import Floats, Indices

FEASIBLE_SPEED_M_S = 7.0
"""The speed at which it says whether a track can be flown, chosen by `studies/racing_speeds.py`."""


class PrivilegedPilot:
    """Flies drones through gates whose true poses it knows, at the speed of the guidance."""

    def __init__(self, speed_m_s: float = FEASIBLE_SPEED_M_S) -> None:
        self._speed_m_s = speed_m_s
        # the name under which stores know it, from when it was called the reference
        self.fingerprint = f"reference at {speed_m_s:g} m/s"

    def start(self, count: int) -> None:
        """Begin new races; nothing is remembered."""

    def act(self, races: RacingEpisodes, which: Indices) -> Floats:
        """Choose actions (n, 4) for some drones."""
        actions: Floats = steer(races.waypoints(which), self._speed_m_s)
        return actions
