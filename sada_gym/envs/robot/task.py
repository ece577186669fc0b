"""SADA-RobotTask: the inner task, on which robots are trained."""

from __future__ import annotations

from dataclasses import replace
from inspect import Parameter as SignatureParameter
from inspect import Signature
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.checks import check_kind
from sada_gym.envs.episodes.task import Task, TaskEnv, TaskVectorEnv
from sada_gym.envs.robot.episodes import RobotEpisodes
from sada_gym.envs.robot.start import PARAMETERS, POLICY_HZ, RobotEnd, TripDistribution
from sada_gym.envs.robot.world.robot import FORWARD_M_S
from sada_gym.errors import check_known
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.lockstep import SAME_STEP

ARRIVAL_REWARD, COLLISION_REWARD = 10.0, -10.0


class RobotTask(Task[RobotEpisodes]):
    """Trips from a start distribution, and their rewards."""

    episodes_class, distribution_class = RobotEpisodes, TripDistribution

    def _step(self, episodes: RobotEpisodes, actions: npt.NDArray[Any]) -> Floats:
        before = episodes.remaining_m.copy()
        episodes.step(np.arange(len(episodes)), actions)
        pace = np.clip((before - episodes.remaining_m) * POLICY_HZ / FORWARD_M_S, -1.0, 1.0)
        end = np.where(episodes.ending == RobotEnd.ARRIVED, ARRIVAL_REWARD, 0.0)
        end = np.where(episodes.ending == RobotEnd.COLLIDED, COLLISION_REWARD, end)
        reward: Floats = pace - 0.1 + end
        return reward

    def ended(self) -> tuple[Bools, Bools]:
        """Say which trips are terminated, and which are truncated: out of time."""
        ending = self.episodes.ending
        truncated = ending == RobotEnd.TOO_LATE
        return (ending != RobotEnd.UNDER_WAY) & ~truncated, truncated

    def info(self, i: int) -> dict[str, Any]:
        """Say where robot i is."""
        return {
            "remaining_m": float(self.episodes.remaining_m[i]),
            "is_success": bool(self.episodes.ending[i] == RobotEnd.ARRIVED),
        }


class RobotTaskEnv(TaskEnv):
    """A robot with a lidar drives to a goal in a warehouse.

    ## Description
    The robot, a TurtleBot 2, decides at 5 Hz how fast it drives and turns. It knows the map of the
    hall (racks and pillars), where it is, and the way that was planned on the map. It does not know
    the barrels and the moving carts, which its lidar shows. The wheels' grip and the motors' torque
    decide what becomes of its commands; pymunk integrates rigid bodies and finds contacts.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: the speed, 1 is 0.6 m/s ahead and -1 is 0.1 m/s backwards; and the
    turning rate, 1 is 1.5 rad/s to the left.

    ## Observation Space
    `Dict`:

    | key | space | what |
    | --- | --- | --- |
    | `lidar` | `Box(0, 1, (36,), float32)` | how near the nearest return of the last four scans is in each sector of 10°, ahead first, then to the left: 1 at the robot's middle, 0 at 3.5 m or where there is none |
    | `state` | `Box(-40, 40, (16,), float32)` | points of the way 0.4, 0.8, 1.2 and 2 m ahead (0 to 7: ahead, to the left, in these distances); what is left of the way in 3 m, at most 1 (8); velocity ahead, to the left, in 0.6 m/s, and turning rate in 1.5 rad/s (9 to 11); the last two actions (12 to 15) |

    ## Rewards
    A step: the distance made along the way as a share of that at 0.6 m/s, from -1 to 1, less 0.1.
    In addition, +10 on arrival and -10 for a collision.

    ## Starting State
    The start of a random trip on a random floor plan, with the robot turned by up to 30°.

    ## Episode End
    Terminated less than 0.3 m from the goal, or when the robot touches something. Truncated 10 s
    after the time that the way takes at 0.25 m/s. `info` holds `remaining_m`, `is_success`.

    ## Arguments
    - `distribution=TripDistribution()`: what floor plans, trips and conditions are drawn from.
    - the fields of `Conditions`, such as `latency_s`: the conditions of all trips; those that are
      not given are the distribution's.
    - `render_mode=None`: `"rgb_array"` draws the hall from above with the robot and its lidar's
      returns.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012
    task_class = RobotTask

    def __init__(
        self,
        distribution: TripDistribution | None = None,
        *,
        render_mode: str | None = None,
        **conditions: float | None,
    ) -> None:
        check_known("condition", conditions, PARAMETERS.names)
        given: dict[str, Any] = {name: x for name, x in conditions.items() if x is not None}
        if given:
            distribution = TripDistribution() if distribution is None else distribution
            check_kind("distribution", distribution, TripDistribution)
            changed = replace(distribution.conditions, **given)
            distribution = replace(distribution, conditions=changed)
        super().__init__(distribution, render_mode=render_mode)

    # the conditions by name, for tools that look up what an environment takes
    __signature__ = Signature(
        [
            SignatureParameter(
                "distribution", SignatureParameter.POSITIONAL_OR_KEYWORD, default=None
            ),
            *(
                SignatureParameter(name, SignatureParameter.KEYWORD_ONLY, default=None)
                for name in (*PARAMETERS.names, "render_mode")
            ),
        ]
    )


class RobotTaskVectorEnv(TaskVectorEnv):
    """`RobotTaskEnv` in lockstep, see `TaskVectorEnv`."""

    metadata: dict[str, Any] = {**RobotTaskEnv.metadata, **SAME_STEP}  # noqa: RUF012
    task_class = RobotTask
