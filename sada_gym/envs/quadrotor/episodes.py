"""Flights in lockstep, the episodes of the quadrotor: each follows a figure of eight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.quadrotor.start import POLICY_HZ, FlightEnd, QuadrotorStart
from sada_gym.envs.quadrotor.world.dynamics import (
    AGES,
    FLIGHT,
    HEIGHT_M,
    MEASURED,
    NEAR_M,
    NEAR_M_S,
    SETTLED,
    STATE,
    STEPS,
    TOLD,
    advance,
    measure,
    observe,
    reference,
)
from sada_gym.foundations.arrays import Bytes, Floats, Indices

FILM_STEPS = 5
"""The steps from one frame of a replay to the next."""

_RANGES = np.repeat(np.array([NEAR_M, 2.0, NEAR_M_S, 100.0, 1.0], np.float32), [3, 9, 3, 3, 4])
OBSERVATION_SPACE = spaces.Dict({"state": spaces.Box(-_RANGES, _RANGES)})
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (4,), np.float32)


class QuadrotorEpisodes(Episodes[QuadrotorStart]):
    """Quadrotors that follow their references in lockstep.

    An observation is a `state` of 22 numbers: position less the reference's in m, at most 0.5; the
    rotation matrix from the body to the world, row by row; velocity less the reference's in m/s, at
    most 1; body rates in rad/s; and the last action. An action is the speeds of the motors front
    right, back right, back left and front left, from -1 (at rest) to 1. x is ahead, y to the left,
    z up.

    Attributes:
        states: (n, 17) of the quadrotors, see `dynamics`.
        targets: (n, 4) of the references: x, y and velocity; all are 1.5 m above the ground.
        winds: (n, 3) in m/s.
        told: (n, 6) what became of them: distance from the reference in m; steps near it, and the
            greatest distance, both after the first two seconds; how far it has turned to and fro in
            rad; the first step upside down (0 if there is none); and the `FlightEnd`.
        actions: (n, 4) the last actions.
    """

    task_id = "the spaces of QuadrotorEpisodes"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, starts: Sequence[QuadrotorStart]) -> None:
        super().__init__(starts)
        n = len(starts)
        self._now = np.zeros((n, STATE + 4 + 3 + TOLD))
        parts = np.split(self._now, np.cumsum([STATE, 4, 3]), axis=1)  # views
        self.states, self.targets, self.winds, self.told = parts
        self.actions = np.zeros((n, 4))
        self._airframes, self._flights = np.zeros((n, 31)), np.zeros((n, FLIGHT))
        self._seen = np.zeros((n, AGES, MEASURED))
        self._noise = np.zeros((n, STEPS + 1, MEASURED + 3), np.float32)
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: QuadrotorStart) -> None:
        """Begin another flight in place i, with the motors as if it hovered."""
        self.starts[i] = start
        now, rng = start.conditions, np.random.default_rng(start.seed)
        offset, attitude = start.place(rng)
        self._noise[i] = rng.standard_normal(self._noise.shape[1:], np.float32)
        body, motors = start.airframe()
        self._airframes[i] = [*body, *motors]
        names = "wind_m_s", "gust_m_s", "noise_m", "delay_s", "speed_m_s"
        self._flights[i] = [now[name] for name in names]
        self.steps[i], self.actions[i], self._now[i] = 0, 0.0, 0.0
        self.states[i, :3] = [*offset[:2], offset[2] + HEIGHT_M]
        self.states[i, 3:7], self.states[i, 13:] = attitude, start.hover
        self.targets[i] = reference(0.0, now["speed_m_s"])
        self.winds[i] = now["gust_m_s"] * self._noise[i, 0, MEASURED:]
        self.winds[i, 0] += now["wind_m_s"]
        self.told[i, 0] = np.sqrt((offset**2).sum())
        first = self._seen[i, 0]
        measure(self.states[i], self.targets[i], self._noise[i, 0], now["noise_m"], first)
        self._seen[i] = first

    def under_way(self) -> Indices:
        """Return the flights that have not ended."""
        return np.flatnonzero(self.told[:, 5] == FlightEnd.UNDER_WAY)

    @property
    def score(self) -> Floats:
        """The shares of the flights near the reference, (n,): 0 after a crash or where lost."""
        return np.where(self.told[:, 5] > FlightEnd.FLOWN, 0.0, self.told[:, 1] / (STEPS - SETTLED))

    def info(self, i: int) -> dict[str, Any]:
        """Say what became of flight i."""
        _, _, far_m, turned_rad, upset, end = self.told[i].tolist()
        flown_s = int(self.steps[i]) / POLICY_HZ
        return {
            "ending": FlightEnd(int(end)).name.lower(),
            "flown_s": flown_s,
            "upset": upset > 0.0,
            "far_m": far_m,
            "turning_rad_s": turned_rad / flown_s if flown_s else 0.0,
        }

    def snapshot(self) -> Batch:
        """Return states, references, winds and what is told."""
        return {name: getattr(self, name) for name in ("states", "targets", "winds", "told")}

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some quadrotors."""
        observed = np.empty((len(which), MEASURED + 4), np.float32)
        observe(which, self._seen, self._flights, self.actions, observed)
        return {"state": observed}

    def render(self, which: Indices) -> Bytes:
        """Draw each quadrotor and its reference."""
        from sada_gym.envs.quadrotor.frame import draw_frame

        parts = zip(which.tolist(), self.states[which], self.targets[which], strict=True)
        return np.stack([draw_frame(self.starts[i], *seen) for i, *seen in parts])

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some quadrotors, whose flights are under way, fly for 10 ms."""
        self.actions[which] = np.clip(self._validate_actions(which, actions), -1.0, 1.0)
        self.steps[which] += 1
        made = self._airframes, self._flights, self._noise
        advance(which, *made, self.steps, self.actions, self._now, self._seen)
