"""Walks in lockstep, the episodes of the Go2: each follows a commanded way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.go2.start import (
    DEFAULT_POSE,
    JOINTS,
    POLICY_HZ,
    PUSH_S,
    STEPS,
    Go2Start,
    WalkEnd,
)
from sada_gym.envs.go2.world.robot import Robot
from sada_gym.foundations.arrays import Bytes, Floats, Indices

FILM_STEPS = 2
"""The steps from one frame of a replay to the next."""
ACTION_SCALE = np.array([0.125, 0.25, 0.25] * 4)
"""How far an action of 1 moves each joint from the default pose, in rad."""
_LIMIT = 100.0
"""Observations and actions are clipped to this, as in the policy's deployment."""
_FALLEN = 0.5
"""A robot has fallen whose trunk is tilted by more than 60 degrees: the cosine."""
_AROUND = POLICY_HZ // 2
"""The way is searched for the robot's place so many steps of the command back and ahead."""

OBSERVATION_SPACE = spaces.Dict(
    {
        "state": spaces.Box(-_LIMIT, _LIMIT, (9 + 3 * JOINTS,), np.float32),
        "velocity": spaces.Box(-_LIMIT, _LIMIT, (3,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-_LIMIT, _LIMIT, (JOINTS,), np.float32)


class Go2Episodes(Episodes[Go2Start]):
    """Robot dogs that walk commanded ways in lockstep.

    An observation is a `state` of 45 numbers, as `rl_sar` lays out what its policies see: body
    rates (in 4 rad/s), the direction of gravity, the command (speeds ahead and to the left in m/s,
    turn in rad/s), the joints' angles less the default pose's (rad), their rates (in 20 rad/s), and
    the last action; and the `velocity` of the trunk, ahead and to the left in m/s, with its turning
    rate in rad/s. An action holds a target for each joint: 1 is 0.125 rad (hips) or 0.25 rad away
    from the default pose. Legs are front right, front left, rear right and rear left.

    Attributes:
        told: (n, 3) what became of them: the share of the way that is done, the cosine of the tilt,
            and the `WalkEnd`.
        actions: (n, 12) the last actions.
    """

    task_id = "SADA-Go2-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, starts: Sequence[Go2Start]) -> None:
        super().__init__(starts)
        n = len(starts)
        self.told, self.actions = np.zeros((n, 3)), np.zeros((n, JOINTS))
        self._at = np.zeros(n, np.int64)
        self._robots: list[Robot] = [None] * n  # type: ignore[list-item]
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: Go2Start) -> None:
        """Begin another walk in place i."""
        robot = self._robots[i] = Robot(start)
        self.starts[i], self.steps[i], self._at[i], self.actions[i] = start, 0, 0, 0.0
        self.told[i] = 0.0, robot.upright, WalkEnd.UNDER_WAY

    @property
    def parts(self) -> Floats:
        """Where the robots' bodies are, (n, 13, 7): x, y, z in m, and a quaternion wxyz."""
        return np.stack([robot.parts for robot in self._robots])

    def under_way(self) -> Indices:
        """Return the walks that have not ended."""
        return np.flatnonzero(self.told[:, 2] == WalkEnd.UNDER_WAY)

    @property
    def score(self) -> Floats:
        """The shares of the ways that are done, (n,): 0 after a fall."""
        return np.where(self.told[:, 2] > WalkEnd.WALKED, 0.0, self.told[:, 0])

    def info(self, i: int) -> dict[str, Any]:
        """Say what became of walk i."""
        done, _, end = self.told[i].tolist()
        x, y, z = self._robots[i].place
        return {
            "ending": WalkEnd(int(end)).name.lower(),
            "walked_s": int(self.steps[i]) / POLICY_HZ,
            "done": done,
            "x_m": x,
            "y_m": y,
            "height_m": z,
            "invalid": self._robots[i].broken,
        }

    def snapshot(self) -> Batch:
        """Return where the robots' bodies are, and what is told."""
        return {"parts": self.parts, "told": self.told}

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some robots."""
        state = np.empty((len(which), 9 + 3 * JOINTS))
        velocity = np.empty((len(which), 3))
        for row, i in enumerate(which.tolist()):
            seen, velocity[row] = self._robots[i].observe()
            state[row, :6], state[row, 9:33] = seen[:6], seen[6:]
            state[row, 6], state[row, 8] = self.starts[i].commands[min(self.steps[i], STEPS - 1)]
        state[:, :3] *= 0.25
        state[:, 7], state[:, 33:] = 0.0, self.actions[which]
        state[:, 9:21] -= DEFAULT_POSE
        state[:, 21:33] *= 0.05
        observed = {"state": state, "velocity": velocity}
        return {
            key: value.clip(-_LIMIT, _LIMIT).astype(np.float32) for key, value in observed.items()
        }

    def render(self, which: Indices) -> Bytes:
        """Draw each robot."""
        from sada_gym.envs.go2.frame import draw_frame

        return np.stack([draw_frame(self.starts[i], self._robots[i].parts) for i in which.tolist()])

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some robots, whose walks are under way, walk for 20 ms."""
        actions = self._validate_actions(which, actions).clip(-_LIMIT, _LIMIT)
        self.actions[which] = actions
        for action, i in zip(actions, which.tolist(), strict=True):
            robot, start, step = self._robots[i], self.starts[i], int(self.steps[i])
            pushed = start.push_at <= step < start.push_at + round(PUSH_S * POLICY_HZ)
            robot.step(DEFAULT_POSE + ACTION_SCALE * action, pushed=pushed)
            self.steps[i] = step + 1
            end = WalkEnd.WALKED if step + 1 == STEPS else WalkEnd.UNDER_WAY
            if robot.broken:
                self.told[i, 2] = WalkEnd.BROKEN
                continue
            upright = robot.upright
            self.told[i] = self._done(i), upright, end if upright > _FALLEN else WalkEnd.FELL

    def _done(self, i: int) -> float:
        """Find the place on the way that is nearest to where the robot is."""
        way, first = self.starts[i].way, max(0, int(self._at[i]) - _AROUND)
        near = way[first : self._at[i] + _AROUND + 1, :2] - self._robots[i].place[:2]
        self._at[i] = first + (near[:, 0] ** 2 + near[:, 1] ** 2).argmin()
        lengths = self.starts[i].lengths
        return float(lengths[self._at[i]] / lengths[-1])
