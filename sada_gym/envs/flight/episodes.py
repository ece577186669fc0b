"""Flights, the episodes of the aircraft: each climbs and turns as commanded, and holds that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.flight.start import (
    COMMAND_S,
    FLIGHT_S,
    POLICY_HZ,
    SETTLED_S,
    START_DEG,
    START_FT,
    WITHIN_DEG,
    WITHIN_FT,
    FlightEnd,
    FlightStart,
)
from sada_gym.envs.flight.world.engine import FIELDS, Flight
from sada_gym.foundations.arrays import Bytes, Floats, Indices

BANK_DEG, NOSE_UP_DEG, NOSE_DOWN_DEG = 45.0, 25.0, -10.0
"""An aeroplane beyond these is upset, by ICAO Doc 10011 and FAA AC 120-111."""
_SCALES = {
    **{"speed_kt": 100.0, "bank_deg": 45.0, "pitch_deg": 25.0, "alpha_rad": 0.3},
    **{"climb_fps": 20.0, "roll_rad_s": 0.5, "pitch_rad_s": 0.5, "yaw_rad_s": 0.5, "throttle": 1.0},
}
_SHOWN = [FIELDS.index(name) for name in _SCALES]
_ALTITUDE, _HEADING, _SPEED, _BANK, _PITCH, _ALPHA = range(6)
_MOST = 10.0
"""Observations are cut off here."""


class FlightEpisodes(Episodes[FlightStart]):
    """Aircraft in JSBSim that fly side by side, each in a simulation of its own.

    An observation is a `state` of 11 numbers, cut off at 10: the commanded altitude less the
    aircraft's in 100 ft, the commanded heading less the aircraft's in 10 degrees, calibrated
    airspeed in 100 kt, bank in 45 degrees, pitch in 25 degrees, angle of attack in 0.3 rad, climb
    in 20 ft/s, the turning rates about the aircraft's axes in 0.5 rad/s, and the throttle. An
    action is what is added to the elevator, the ailerons, the rudder and the throttle as the crew
    holds them, each in [-1, 1]. The autopilot is off until `engage` is called.

    Attributes:
        flights: The simulations.
        states: (n, 13) see `FIELDS`.
        told: (n, 4) what became of them: the judged steps within the bounds; the greatest
            distances from the commanded altitude in ft and heading in degrees when judged; and the
            `FlightEnd`.
    """

    task_id = "SADA-Flight-v0"
    observation_space = spaces.Dict({"state": spaces.Box(-_MOST, _MOST, (2 + len(_SHOWN),))})
    action_space: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (4,), np.float32)

    def __init__(self, starts: Sequence[FlightStart]) -> None:
        super().__init__(starts)
        self.flights: list[Flight | None] = [None] * len(starts)
        self.states, self.told = np.zeros((len(starts), len(FIELDS))), np.zeros((len(starts), 4))
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: FlightStart) -> None:
        """Begin another flight in place i, with the autopilot off."""
        self.flights[i] = flight = Flight(start)
        self.starts[i], self.steps[i], self.told[i] = start, 0, 0.0
        self.states[i] = flight.state()
        if flight.fault or not np.isfinite(self.states[i]).all():
            self.told[i, 3] = FlightEnd.INVALID

    def engage(self, which: Indices) -> None:
        """Switch the autopilots of some aircraft on; actions then add to what they do."""
        for i in which.tolist():
            self._flight(i).engage()

    def under_way(self) -> Indices:
        """Return the flights that have not ended."""
        return np.flatnonzero(self.told[:, 3] == 0.0)  # a number: comparing an enum is slow

    @property
    def score(self) -> Floats:
        """The shares of the last 40 s within the bounds, (n,): 0 after a stall or an upset."""
        held = self.told[:, 0] / (POLICY_HZ * (FLIGHT_S - SETTLED_S))
        return np.where(self.told[:, 3] > FlightEnd.FLOWN, 0.0, held)

    def info(self, i: int) -> dict[str, Any]:
        """Say what became of flight i."""
        state, (_, far_ft, far_deg, end) = self.states[i], self.told[i].tolist()
        invalid = "JSBSim could not compute the flight" if end == FlightEnd.INVALID else ""
        return {
            "ending": FlightEnd(int(end)).name.lower(),
            "flown_s": int(self.steps[i]) / POLICY_HZ,
            "altitude_error_ft": far_ft,
            "heading_error_deg": far_deg,
            "speed_kt": 0.0 if invalid else float(state[_SPEED]),
            "invalid": self._flight(i).fault or invalid,
        }

    def commanded(self, i: int) -> tuple[float, float]:
        """Return the altitude in ft and the heading in degrees that are commanded now."""
        start, is_told = self.starts[i], self.steps[i] >= COMMAND_S * POLICY_HZ
        return (start.altitude_ft, start.heading_deg) if is_told else (START_FT, START_DEG)

    def errors(self, i: int) -> tuple[float, float]:
        """Return what is commanded less what is flown: ft and degrees, the shorter way round."""
        altitude_ft, heading_deg = self.commanded(i)
        turn = (heading_deg - float(self.states[i, _HEADING]) + 180.0) % 360.0 - 180.0
        return altitude_ft - float(self.states[i, _ALTITUDE]), turn

    def snapshot(self) -> Batch:
        """Return states, commands and what is told."""
        commands = np.array([self.commanded(i) for i in range(len(self))])
        return {"states": self.states, "commands": commands, "told": self.told}

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some aircraft."""
        errors = np.array([self.errors(i) for i in which.tolist()]) / [WITHIN_FT, WITHIN_DEG]
        shown = self.states[which][:, _SHOWN] / [*_SCALES.values()]
        state = np.column_stack([errors, shown]).clip(-_MOST, _MOST)
        return {"state": state.astype(np.float32)}

    def render(self, which: Indices) -> Bytes:
        """Draw each aircraft's attitude, and its way."""
        from sada_gym.envs.flight.frame import draw_frame

        return np.stack(
            [draw_frame(self.starts[i], self.states[i], self.commanded(i)) for i in which.tolist()]
        )

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some aircraft, whose flights are under way, fly for a quarter of a second."""
        if actions.any() or actions.shape != (len(which), 4):  # the autopilot's are zeros
            actions = np.clip(self._validate_actions(which, actions), -1.0, 1.0)
        for i, control in zip(which.tolist(), actions.tolist(), strict=True):
            flight = self._flight(i)
            flight.fly(control)
            self.steps[i] += 1
            self._judge(i, flight.state())

    def close(self) -> None:
        """Free the simulations."""
        self.flights = [None] * len(self)

    def _flight(self, i: int) -> Flight:
        flight = self.flights[i]
        assert flight is not None
        return flight

    def _judge(self, i: int, state: list[float]) -> None:
        step, built, end = int(self.steps[i]), self.starts[i].built, FlightEnd.UNDER_WAY
        if not all(map(math.isfinite, state)):
            self.told[i, 3] = FlightEnd.INVALID  # the last state that there was stays
            return
        self.states[i] = state
        if state[_ALPHA] >= math.radians(built.stall_deg):
            end = FlightEnd.STALLED
        elif abs(state[_BANK]) > BANK_DEG or not NOSE_DOWN_DEG <= state[_PITCH] <= NOSE_UP_DEG:
            end = FlightEnd.UPSET
        elif state[_SPEED] > built.never_kt:
            end = FlightEnd.OVERSPEED
        elif step >= FLIGHT_S * POLICY_HZ:
            end = FlightEnd.FLOWN
        if end is not FlightEnd.UNDER_WAY:
            self.told[i, 3] = end
        if step > SETTLED_S * POLICY_HZ:
            told, (altitude_ft, turn_deg) = self.told[i], map(abs, self.errors(i))
            told[0] += altitude_ft <= WITHIN_FT and turn_deg <= WITHIN_DEG
            told[1], told[2] = max(told[1], altitude_ft), max(told[2], turn_deg)
