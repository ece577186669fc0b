"""Races in lockstep, the episodes of UAV racing: drones, the gates they pass, those they miss.

A gate is passed when the drone crosses its opening, in the gate's direction and in the gates'
order. A gate is missed when the drone touches a frame or the ground on the way there, when that
takes longer than `GATE_LIMIT_S`, or when the drone is lost: out of the world, or with an action
that is not a finite number. Then the drone is set back at rest into the last gate that it passed,
and the race goes on to the gate after the missed one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.checks import bounded, check_bounds
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.world.drone import (
    GRAVITY_M_S2,
    MASS_KG,
    SIMULATION_HZ,
    control,
    heading_of,
    upright,
)
from sada_gym.envs.uav.world.guidance import TOP_SPEED_M_S, waypoints
from sada_gym.envs.uav.world.physics import free_bodies
from sada_gym.envs.uav.world.referee import (
    GateOutcome,
    judge,
    observed_gates,
    observed_motion,
    orders,
)
from sada_gym.envs.uav.world.track import GATES, TEMPLATES, Tracks, along, template
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes, Floats, Indices

POLICY_HZ = 20
REPLAY_HZ = 10
"""The frames of a replay in a second: one for every second decision."""
GATE_LIMIT_S = 10.0
GATES_AHEAD = 2
"""The number of gates in an observation."""

OBSERVATION_SPACE = spaces.Dict(
    {
        "gates": spaces.Box(-1.0, 1.0, (5 * GATES_AHEAD,), np.float32),
        "motion": spaces.Box(-1.0, 1.0, (9,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (4,), np.float32)

_SUBSTEPS = SIMULATION_HZ // POLICY_HZ
_GATE_LIMIT = round(GATE_LIMIT_S * SIMULATION_HZ)


@dataclass(frozen=True)
class RacingStart:
    """How one race begins."""

    gates: Floats  # (g, 4) x, y, z and heading of each
    place: tuple[float, float, float, float]  # x, y, z and heading of the drone
    seed: int = 0  # the number that fixes light and background
    # the drone's velocity in the world, in m/s
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    first: int = 0  # the first gate to pass; those before it count as passed
    # (k, 2) the track's anchor points, for pictures
    anchors: Floats = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def state(self) -> Floats:
        """The drone's first state, (13,)."""
        state = upright(self.place[:3], self.place[3])
        state[7:10] = self.velocity
        return state


class RacingEpisodes(Episodes[RacingStart]):
    """Drones that race in lockstep, each as if it were alone; all have the same number of gates.

    Attributes:
        tracks: The tracks of all races, where they are known.
        gates: (n, g, 4) x, y, z and heading.
        states: (n, 13) of the drones: position, quaternion xyzw, velocity, angular velocity.
        next_gate: (n,) intp, the gate to pass next; g where a race is over.
        endings: (n, g) int8, of `GateOutcome`.
        ended_at: (n, g, 3) where the drone was when a gate was passed or missed; NaN before.
        time_s: (n,) the time flown.
    """

    task_id = "SADA-RacingTask-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE
    finite_only = False

    def __init__(self, starts: Sequence[RacingStart], tracks: Tracks | None = None) -> None:
        super().__init__(starts)
        self.tracks = tracks
        count, gates = len(starts), len(starts[0].gates)
        self.gates = np.empty((count, gates, 4))
        self.states = np.empty((count, 13))
        self.next_gate = np.zeros(count, np.intp)
        self.endings = np.zeros((count, gates), np.int8)
        self.ended_at = np.empty((count, gates, 3))
        self.time_s = np.zeros(count)
        self._since = np.zeros(count, np.int64)
        self._headings = np.empty(count)
        self._rotors = np.empty((count, 4))
        self._commands = np.empty((count, 4))
        for i, start in enumerate(starts):
            self.begin(i, start)

    @property
    def score(self) -> Floats:
        """The share of gates passed, (n,)."""
        share: Floats = (self.endings == GateOutcome.PASSED).mean(axis=1)
        return share

    def begin(self, i: int, start: RacingStart) -> None:
        """Begin another race in place i."""
        self.starts[i] = start
        self.gates[i] = start.gates
        self.next_gate[i] = start.first
        self.endings[i] = GateOutcome.AHEAD
        self.endings[i, : start.first] = GateOutcome.PASSED
        self.ended_at[i] = np.nan
        self.steps[i], self.time_s[i], self._since[i] = 0, 0.0, 0
        self.place(i, start.state)

    def place(self, i: int, state: Floats) -> None:
        """Set drone i to a state (13,), its rotors as if it hovered."""
        self.states[i] = state
        self._headings[i] = heading_of(*state[3:7])
        self._rotors[i] = MASS_KG * GRAVITY_M_S2 / 4

    def under_way(self) -> Indices:
        """Return the races that are not over."""
        return np.flatnonzero(self.next_gate < self.gates.shape[1])

    def snapshot(self) -> Batch:
        """Return states, what became of each gate and where, and the time flown."""
        names = ("states", "endings", "ended_at", "time_s")
        return {name: getattr(self, name) for name in names}

    def waypoints(self, which: Indices, ahead: int = 0) -> Floats:
        """Return the true waypoints of some drones, (n, 4): see `guidance`.

        They are of the next gate, or of one `ahead` of it; after the last comes the first.
        """
        gate = (self.next_gate[which] + ahead) % self.gates.shape[1]
        return waypoints(self.gates[which, gate], self.states[which])

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some pilots, see `RacingTaskEnv`."""
        ahead = [observed_gates(self.waypoints(which, number)) for number in range(GATES_AHEAD)]
        return {
            "gates": np.concatenate(ahead, axis=1),
            "motion": observed_motion(self.states[which]),
        }

    def render(self, which: Indices) -> Bytes:
        """Draw what some of the drones' cameras see."""
        seeds = [self.starts[i].seed for i in which.tolist()]
        return camera().draw(self.gates[which], self.states[which], seeds)

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some drones, whose races are not over, fly for a decision's time.

        Actions (n, 4) are clipped to [-1, 1], see `guidance.steer`. A drone whose action is not
        finite is lost.
        """
        actions = self._validate_actions(which, actions)
        self.steps[which] += 1
        flight = self.states, self.next_gate, self.endings, self.ended_at
        # no number that is none may reach PyBullet, where the others are
        orders(which, actions, *flight, self._headings, self._commands)
        self._set_back(which)
        which = which[self.next_gate[which] < self.gates.shape[1]]
        bodies = free_bodies()
        bodies.place(self.states[which, :7])
        clock = self.time_s, self._since, _GATE_LIMIT
        for _ in range(_SUBSTEPS):
            before = self.states[:, :3].copy()
            control(which, self.states, self._commands, self._headings, self._rotors)
            self.states[which, :7] = bodies.step(self.states[which, 7:])
            judge(which, before, self.gates, *flight, *clock)
        self._set_back(which)

    def _set_back(self, which: Indices) -> None:
        next_gate = np.minimum(self.next_gate[which], self.gates.shape[1] - 1)
        for i in which[self.endings[which, next_gate] > GateOutcome.PASSED].tolist():
            self.next_gate[i] += 1
            self._since[i] = 0
            passed = np.flatnonzero(self.endings[i] == GateOutcome.PASSED)
            last = self.gates[i, passed[-1]].tolist() if passed.size else self.starts[i].place
            self.place(i, upright(last[:3], last[3]))


START_SHIFT_M = 0.3
"""A seed moves the drone from the start by at most this, along x and along y."""
START_TURN_DEG = 5.0
"""A seed turns the drone by at most this."""


@dataclass(frozen=True)
class RaceDistribution:
    """A distribution of races on tracks around the templates.

    A race may begin between any two gates; it is a lap all the same.

    Attributes:
        anchors: The numbers of anchor points that occur.
        spread: The greatest distance from 0 of each number of mu.
        shift_m: The greatest distance from the track's line, along x and along y.
        turned_deg: The greatest angle by which a drone is turned.
        speed_m_s: The greatest speed at which it starts, to where it heads.
    """

    anchors: tuple[int, ...] = tuple(TEMPLATES)
    spread: float = bounded(0.0, 1.0, 0.25)
    shift_m: float = bounded(0.0, 1.0, 0.5)
    turned_deg: float = bounded(0.0, 45.0, 15.0)
    speed_m_s: float = bounded(0.0, TOP_SPEED_M_S, 10.0)

    def __post_init__(self) -> None:
        """Reject unknown templates, and starts far off the track."""
        if not isinstance(self.anchors, tuple) or not self.anchors:
            raise UserError(
                f"Expected anchors to be a tuple of at least one number, got {self.anchors!r}."
            )
        for count in self.anchors:
            template(count)
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> RacingStart:
        """Draw one race."""
        chosen = template(int(self.anchors[rng.integers(len(self.anchors))]))
        mu = rng.uniform(-self.spread, self.spread, (1, len(chosen.parameters)))
        track = chosen.tracks(mu)
        anchors = track.anchors[0]
        first = int(rng.integers(GATES))
        (place,), _ = along(anchors, np.array([(first + 0.5) / GATES]))
        x, y = place[:2] + rng.uniform(-self.shift_m, self.shift_m, 2)
        turned = np.deg2rad(rng.uniform(-self.turned_deg, self.turned_deg))
        heading, speed = float(place[3] + turned), float(rng.uniform(0, self.speed_m_s))
        return RacingStart(
            gates=np.roll(track.gates[0], -first, axis=0),
            place=(float(x), float(y), float(place[2]), heading),
            seed=int(rng.integers(2**31)),
            velocity=(speed * float(np.cos(heading)), speed * float(np.sin(heading)), 0.0),
            anchors=anchors,
        )


def benchmark_starts(tracks: Tracks, seeds: Sequence[int]) -> list[RacingStart]:
    """Make the benchmark's starts on some tracks: at rest near the start, moved by the seeds."""
    starts = []
    laid = zip(tracks.gates, tracks.starts, tracks.anchors, seeds, strict=True)
    for gates, (x, y, z, heading), anchors, seed in laid:
        draw = np.random.default_rng(seed).uniform(-1, 1, 3).tolist()
        place = (
            float(x) + START_SHIFT_M * draw[0],
            float(y) + START_SHIFT_M * draw[1],
            float(z),
            float(heading) + float(np.deg2rad(START_TURN_DEG)) * draw[2],
        )
        starts.append(RacingStart(gates, place, seed, anchors=anchors))
    return starts
