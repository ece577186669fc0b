"""SADA-UAV as Gymnasium environments: a racing pilot attacked through the shape of the track."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.uav.agent.pilot import PilotLike
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.episodes import REPLAY_HZ


class UAVEnv(AdversaryEnv):
    """A frozen pilot flies a racing drone through eight gates.

    ## Description
    Three, four or five anchor points control a closed quadratic B-spline; eight gates stand on it
    at equal arc length and face along it. The adversary moves the anchor points: turns become
    sharper, and on a short track gates stand close together. The score Q is the share of the gates
    that the drone passes on one lap. Where it does not pass a gate in 10 s, or is lost, the gate is
    missed: the drone is set back at rest into the last gate that it passed, and the race goes on to
    the gate after the missed one. Hitting a frame is not a miss. The drone is a rigid body in
    PyBullet; templates, ranges and spacing are our own, since the paper's were never published. The
    seed fixes light and background, and moves the start by up to 0.3 m along x and y, and 5
    degrees.

    ## Action Space
    `Box(-1, 1, (2 anchors,), float32)`: the displacements of the anchor points along x and y, the
    first point's first, linear from minus to plus the range:

    | anchors | size | range in m |
    | --- | --- | --- |
    | 3 | 6 | 18.5 |
    | 4 | 8 | 15 |
    | 5 | 10 | 13 |

    For every mu all frames are at least 0.9 m apart. Where they would not be, as for one uniform mu
    in twenty, all displacements are reduced by the same share until they are. `parameters` in
    `info` are the displacements before that; the track has `kept` times these.

    ## Observation Space
    `Box(-1, 1, (2 anchors + 2,), float32)`: last mu, last score, share of the steps left; zeros
    where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of gates passed.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.7), `seed`, `parameters`, `gates_passed`, `endings` (for each gate
    `passed`, `late` or `lost`), `touched` (whether the drone hit anything on its way to each gate),
    `time_s` (the time for the course), and of the track `length_m`, `sharpest_turn_deg` (the
    greatest turn from the start or a gate to the next, of more than 180 where the track loops),
    `closest_m` (the smallest distance between two frames) and `kept` (how much of the displacements
    was kept, 1 but for one uniform mu in twenty).

    ## Arguments
    - `anchors=3`: 3, 4 or 5; each has an id of its own, such as `SADA-UAV-4Anchors-v0`.
    - `agent="waypoint-pid"`: a shipped pilot (`waypoint-pid`, `ppo`), a file of weights that our
      training scripts wrote, a perception network (`WaypointNetwork`), or an SB3 model trained on
      `SADA-RacingTask-v0`.
    - `agent_id=None`: names an in-memory model in evaluation stores; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    metadata: dict[str, Any] = {**AdversaryEnv.metadata, "render_fps": REPLAY_HZ}  # noqa: RUF012

    def __init__(
        self,
        anchors: int = 3,
        *,
        agent: str | Path | PilotLike = "waypoint-pid",
        agent_id: str | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = UAVApplication(anchors, agent=agent, agent_id=agent_id)
        super().__init__(application, horizon=horizon, render_mode=render_mode)


class UAVVectorEnv(AdversaryVectorEnv):
    """`UAVEnv` in a batch: all drones of all worlds race in lockstep."""

    metadata: dict[str, Any] = {**AdversaryVectorEnv.metadata, "render_fps": REPLAY_HZ}  # noqa: RUF012

    def __init__(
        self,
        anchors: int = 3,
        *,
        num_envs: int = 1,
        agent: str | Path | PilotLike = "waypoint-pid",
        agent_id: str | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = UAVApplication(anchors, agent=agent, agent_id=agent_id)
        super().__init__(application, num_envs=num_envs, horizon=horizon, render_mode=render_mode)
