"""Many races in lockstep: drones on tracks, which gates they pass, and how the others were missed.

A gate is passed when the drone crosses its opening, in the gate's direction and in the gates'
order. Where that takes longer than `GATE_LIMIT_S`, or the drone is lost (on its back on the ground,
out of the world, or told something that is no number), the gate is missed: the drone is set at rest
into that gate, and the race goes on to the one after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numba as nb
import numpy as np
import numpy.typing as npt

from sada_gym.envs.uav.drone import (
    FRAMES,
    GRAVITY_M_S2,
    MASS_KG,
    REACH_M,
    SIMULATION_HZ,
    SLOTS,
    World,
    control,
    heading_of,
    rotation,
    upright,
)
from sada_gym.envs.uav.gates import OPENING_HEIGHT_M, OPENING_WIDTH_M
from sada_gym.envs.uav.guidance import TOP_SPEED_M_S, TOP_TURN_RAD_S, waypoints
from sada_gym.envs.uav.track import to_frame

POLICY_HZ = 20
GATE_LIMIT_S = 10.0
GATES_AHEAD = 2
"""So many gates stand in an observation."""
UNIT_M, UNIT_RAD_S = 20.0, 10.0
"""What an observation's distances and turning rates are divided by."""
WORLD_M, CEILING_M = 80.0, 15.0
"""A drone further from the middle, or higher, is lost."""
FALLEN_M = 0.5
"""A drone that is lower and upside down is lost."""

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Observation = dict[str, npt.NDArray[Any]]
"""`gates` (n, 10) and `motion` (n, 9), float32 in [-1, 1]."""

_SUBSTEPS = SIMULATION_HZ // POLICY_HZ
_GATE_LIMIT = round(GATE_LIMIT_S * POLICY_HZ)
_MOST_WINDUP_RAD = 0.3
_TOUCH_M_S = 1e-6
_kernel = nb.njit(cache=True, nogil=True, error_model="numpy")


class Ending(IntEnum):
    """What became of a gate."""

    AHEAD = 0
    PASSED = 1
    LATE = 2
    LOST = 3


@dataclass(frozen=True)
class Start:
    """What one race is made of.

    Attributes:
        gates: (g, 4) x, y, z and heading of each.
        place: x, y, z and heading of the drone.
        seed: Fixes the looks of the world.
        velocity: The drone's, in the world, in m/s.
        first: The first gate to pass; those before it count as passed.
    """

    gates: Array
    place: tuple[float, float, float, float]
    seed: int = 0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    first: int = 0

    @property
    def state(self) -> Array:
        """The drone's first state, (13,)."""
        state = upright(self.place[:3], self.place[3])
        state[7:10] = self.velocity
        return state


class Races:
    """Drones that race in lockstep, each as if it were alone.

    Args:
        starts: One a race; all have the same number of gates.

    Attributes:
        starts: What each race was made of.
        gates: (n, g, 4) x, y, z and heading.
        states: (n, 13) of the drones: position, quaternion xyzw, velocity, angular velocity.
        next_gate: (n,) intp, the gate to pass next; g where a race is over.
        endings: (n, g) int8, of `Ending`.
        touched: (n, g) bool, where a drone touched anything on its way to a gate.
        steps: (n,) int64, decisions taken.
        time_s: (n,) flown.
    """

    def __init__(self, starts: Sequence[Start]) -> None:
        count, gates = len(starts), len(starts[0].gates)
        self.starts: list[Start] = [*starts]
        self.gates = np.empty((count, gates, 4))
        self.states = np.empty((count, 13))
        self.next_gate = np.zeros(count, np.intp)
        self.endings = np.zeros((count, gates), np.int8)
        self.touched = np.zeros((count, gates), np.bool_)
        self.steps = np.zeros(count, np.int64)
        self.time_s = np.zeros(count)
        self._since = np.zeros(count, np.int64)
        self._headings = np.empty(count)
        self._rotors = np.empty((count, 4))
        self._worlds = [World() for _ in range(-(-count // SLOTS))]
        for i, start in enumerate(starts):
            self.begin(i, start)

    def __len__(self) -> int:
        """Number of races."""
        return len(self.starts)

    @property
    def score(self) -> Array:
        """The share of gates passed, (n,)."""
        share: Array = (self.endings == Ending.PASSED).mean(axis=1)
        return share

    def begin(self, i: int, start: Start) -> None:
        """Put another race in place i."""
        self.starts[i] = start
        self.gates[i] = start.gates
        self.next_gate[i] = start.first
        self.endings[i] = Ending.AHEAD
        self.endings[i, : start.first] = Ending.PASSED
        self.touched[i] = False
        self.steps[i], self.time_s[i], self._since[i] = 0, 0.0, 0
        world, slot = divmod(i, SLOTS)
        self._worlds[world].fill(slot, start.state)
        self.place(i, start.state)

    def place(self, i: int, state: Array) -> None:
        """Set drone i to a state (13,), its rotors as if it hovered."""
        self.states[i] = state
        self._headings[i] = heading_of(*state[3:7])
        self._rotors[i] = MASS_KG * GRAVITY_M_S2 / 4
        world, slot = divmod(i, SLOTS)
        self._worlds[world].place(slot, state)

    def under_way(self) -> Indices:
        """Which races are not over."""
        return np.flatnonzero(self.next_gate < self.gates.shape[1])

    def waypoints(self, which: Indices, ahead: int = 0) -> Array:
        """The true waypoints of some drones, (n, 4): see `guidance`.

        Args:
            which: (n,) those.
            ahead: 0 for the next gate, 1 for the one after it; after the last comes the first.
        """
        gate = (self.next_gate[which] + ahead) % self.gates.shape[1]
        return waypoints(self.gates[which, gate], self.states[which])

    def observe(self, which: Indices) -> Observation:
        """What the pilots of some drones are told, see `RacingTaskEnv`."""
        ahead = [_seen(self.waypoints(which, number)) for number in range(GATES_AHEAD)]
        return {
            "gates": np.concatenate(ahead, axis=1),
            "motion": _motion(self.states[which]),
        }

    def step(self, which: Indices, actions: Array) -> None:
        """Let some drones fly for a decision's time.

        Args:
            which: (n,) those; their races must not be over.
            actions: (n, 4) in [-1, 1], see `guidance.steer`; a drone that is told something that is
                no finite number is lost.
        """
        told = np.array(actions, np.float64)
        # no such number may reach PyBullet, where the others are
        silent = ~np.isfinite(told).all(axis=1) | _lost(self.states[which])
        self.steps[which] += 1
        for i in which[silent].tolist():
            self._miss(i, Ending.LOST)
        told[silent] = 0.0
        told = np.clip(told, -1.0, 1.0)
        flying = self.next_gate[which] < self.gates.shape[1]
        which, told = which[flying], told[flying]
        for number, world in enumerate(self._worlds):
            here = which // SLOTS == number
            if here.any():
                self._fly(world, which[here], told[here])
        self._since[which] += 1
        self._judge(which)
        for i in which[self.next_gate[which] == self.gates.shape[1]].tolist():
            # it would fall to the ground, and cost the others time there
            self._worlds[i // SLOTS].clear(i % SLOTS)

    def close(self) -> None:
        """Free the worlds; doing it again is fine."""
        for world in self._worlds:
            world.close()

    def _fly(self, world: World, which: Indices, told: Array) -> None:
        """Let drones of one world fly."""
        slots = (which % SLOTS).tolist()
        states, gates = self.states[which], self.gates[which]
        near = _near(gates, states)
        for row, slot in enumerate(slots):
            world.surround(slot, gates[row], near[row].tolist())
        commands, headings = _orders(told, states, self._headings[which])
        rotors, wrenches = self._rotors[which], np.empty((len(which), 6))
        next_gate, endings = self.next_gate[which], self.endings[which]
        touched, time_s = self.touched[which], self.time_s[which]
        since = self._since[which]
        for _ in range(_SUBSTEPS):
            control(states, commands, headings, rotors, wrenches)
            after = world.push(slots, states, wrenches)
            _referee(states, after, wrenches, gates, next_gate, endings, touched, time_s, since)
            states = after
        self.states[which], self._headings[which] = states, headings
        self._rotors[which] = rotors
        self.next_gate[which], self.endings[which] = next_gate, endings
        self.touched[which], self.time_s[which] = touched, time_s
        self._since[which] = since

    def _judge(self, which: Indices) -> None:
        """Find who is lost or late."""
        lost = _lost(self.states[which])
        late = self._since[which] >= _GATE_LIMIT
        for i, astray in zip(which[lost | late].tolist(), lost[lost | late], strict=True):
            if self.next_gate[i] < self.gates.shape[1]:
                self._miss(i, Ending.LOST if astray else Ending.LATE)

    def _miss(self, i: int, how: Ending) -> None:
        """The race goes on in the gate that was missed."""
        gate = self.next_gate[i]
        self.endings[i, gate] = how
        self.next_gate[i] += 1
        self._since[i] = 0
        x, y, z, heading = self.gates[i, gate].tolist()
        self.place(i, upright((x, y, z), heading))


@_kernel
def _seen(waypoints: Array) -> npt.NDArray[np.float32]:
    """Waypoints (n, 4) as observed: place over `UNIT_M`, cosine and sine of the heading."""
    seen = np.empty((len(waypoints), 5), np.float32)
    for i in range(len(waypoints)):
        for k in range(3):
            seen[i, k] = min(max(waypoints[i, k] / UNIT_M, -1.0), 1.0)
        seen[i, 3], seen[i, 4] = math.cos(waypoints[i, 3]), math.sin(waypoints[i, 3])
    return seen


@_kernel
def _motion(states: Array) -> npt.NDArray[np.float32]:
    """Velocity in the level frame, the world's up in the body's frame, and body rates."""
    felt = np.empty((len(states), 9))
    for i in range(len(states)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        cosine, sine = math.cos(heading), math.sin(heading)
        r = rotation(s[3], s[4], s[5], s[6])
        felt[i, 0] = (s[7] * cosine + s[8] * sine) / TOP_SPEED_M_S
        felt[i, 1] = (s[8] * cosine - s[7] * sine) / TOP_SPEED_M_S
        felt[i, 2] = s[9] / TOP_SPEED_M_S
        for k in range(3):
            felt[i, 3 + k] = r[2, k]
            felt[i, 6 + k] = (r[0, k] * s[10] + r[1, k] * s[11] + r[2, k] * s[12]) / UNIT_RAD_S
        for k in range(9):
            felt[i, k] = min(max(felt[i, k], -1.0), 1.0)
    return felt.astype(np.float32)


@_kernel
def _near(gates: Array, states: Array) -> npt.NDArray[np.int64]:
    """The frames that each drone could touch soon, the nearest first: (n, FRAMES), -1 for none."""
    near = np.full((len(states), FRAMES), -1)
    least = np.empty(FRAMES)
    for i in range(len(states)):
        least[:] = REACH_M
        for k in range(gates.shape[1]):
            away = to_frame(gates[i, k], states[i, 0], states[i, 1])
            at = FRAMES
            while at > 0 and away < least[at - 1]:
                at -= 1
            if at < FRAMES:
                for m in range(FRAMES - 1, at, -1):
                    near[i, m], least[m] = near[i, m - 1], least[m - 1]
                near[i, at], least[at] = k, away
    return near


@_kernel
def _orders(told: Array, states: Array, headings: Array) -> tuple[Array, Array]:
    """Commands of the flight controller from actions, and the headings that it starts from."""
    commands, begun = np.empty((len(told), 4)), np.empty(len(told))
    for i in range(len(told)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        forward, left = told[i, 0], told[i, 1]
        over = max(math.hypot(forward, left), 1.0)
        forward, left = forward / over * TOP_SPEED_M_S, left / over * TOP_SPEED_M_S
        cosine, sine = math.cos(heading), math.sin(heading)
        commands[i, 0] = forward * cosine - left * sine
        commands[i, 1] = forward * sine + left * cosine
        commands[i, 2] = told[i, 2] * TOP_SPEED_M_S
        commands[i, 3] = told[i, 3] * TOP_TURN_RAD_S
        behind = (headings[i] - heading + math.pi) % (2 * math.pi) - math.pi
        begun[i] = heading + min(max(behind, -_MOST_WINDUP_RAD), _MOST_WINDUP_RAD)
    return commands, begun


@_kernel
def _referee(
    before: Array,
    after: Array,
    wrenches: Array,
    gates: Array,
    next_gate: npt.NDArray[np.intp],
    endings: npt.NDArray[np.int8],
    touched: npt.NDArray[np.bool_],
    time_s: Array,
    since: npt.NDArray[np.int64],
) -> None:
    """See which gates were passed in one step of the simulation, and what was touched."""
    for i in range(len(before)):
        k = next_gate[i]
        if k == gates.shape[1]:
            continue
        time_s[i] += 1 / SIMULATION_HZ
        for axis in range(3):
            pull = wrenches[i, axis] / MASS_KG - (GRAVITY_M_S2 if axis == 2 else 0.0)
            free = before[i, 7 + axis] + pull / SIMULATION_HZ
            if abs(after[i, 7 + axis] - free) > _TOUCH_M_S:
                touched[i, k] = True
        g = gates[i, k]
        cosine, sine = math.cos(g[3]), math.sin(g[3])
        was = (before[i, 0] - g[0]) * cosine + (before[i, 1] - g[1]) * sine
        now = (after[i, 0] - g[0]) * cosine + (after[i, 1] - g[1]) * sine
        if not was < 0.0 <= now:
            continue
        share = was / (was - now)
        x = before[i, 0] + share * (after[i, 0] - before[i, 0]) - g[0]
        y = before[i, 1] + share * (after[i, 1] - before[i, 1]) - g[1]
        z = before[i, 2] + share * (after[i, 2] - before[i, 2]) - g[2]
        if abs(y * cosine - x * sine) <= OPENING_WIDTH_M / 2 and abs(z) <= OPENING_HEIGHT_M / 2:
            endings[i, k] = 1
            next_gate[i] = k + 1
            since[i] = 0


@_kernel
def _lost(states: Array) -> npt.NDArray[np.bool_]:
    """Which drones are on their backs, out of the world or no numbers."""
    lost = np.empty(len(states), np.bool_)
    for i in range(len(states)):
        s = states[i]
        at_home = abs(s[0]) < WORLD_M and abs(s[1]) < WORLD_M and -1.0 < s[2] < CEILING_M
        fallen = s[2] < FALLEN_M and rotation(s[3], s[4], s[5], s[6])[2, 2] < 0.0
        sane = True
        for k in range(7, 13):
            sane = sane and math.isfinite(s[k])
        lost[i] = fallen or not (at_home and sane)
    return lost
