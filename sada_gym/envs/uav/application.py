"""UAV racing under attack: the shape of the track; Q is the share of gates passed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.application import Scored
from sada_gym.envs.episodes.closed_loop import SimulatorApplication
from sada_gym.envs.uav.agent.pilot import Pilot, PilotLike, as_pilot
from sada_gym.envs.uav.episodes import POLICY_HZ, REPLAY_HZ, RacingEpisodes, benchmark_starts
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import template
from sada_gym.parameters import Mu


class UAVApplication(SimulatorApplication[RacingEpisodes]):
    """A frozen pilot flies a racing drone through eight gates.

    ## Description
    Three, four or five anchor points control a closed curve, a quadratic B-spline. Eight gates
    stand on it at equal distances and face along it. The adversary moves the anchor points: turns
    become sharper, and gates stand closer together or farther apart. The score Q is the share of
    the gates that the drone passes on one lap. The drone misses a gate where it touches a frame or
    the ground, does not pass the gate in 10 s, or leaves the world. Then it is set back at rest
    into the last gate that it passed, and the race goes on to the gate after the missed one. The
    drone is a rigid body in PyBullet. The seed fixes light and background, and moves the start by
    up to 0.3 m along x and y, and by up to 5 degrees.

    ## Action Space
    `Box(-1, 1, (2 anchors,), float32)`: for each anchor point in turn, how far it is moved
    along x and along y; -1 to 1 are minus to plus the range:

    | anchors | size | range in m |
    | --- | --- | --- |
    | 3 | 6 | 18.5 |
    | 4 | 8 | 15 |
    | 5 | 10 | 13 |

    Frames are at least 0.9 m apart. Where mu would put them closer, as one uniform mu in twenty
    does, all displacements are reduced by the same share. `parameters` in `info` are the
    displacements before that; the track has `kept` times these.

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
    `passed`, `hit`, `late` or `lost`), `time_s` (the time for the lap), and of the track
    `length_m`, `sharpest_turn_deg` (the greatest turn from the start or a gate to the next, of more
    than 180 where the track loops), `closest_m` (the smallest distance between two frames) and
    `kept` (how much of the displacements was kept, 1 but for one uniform mu in twenty).

    ## Arguments
    - `anchors=3`: 3, 4 or 5; each has an id of its own, such as `SADA-UAV-4Anchors-v0`.
    - `agent="ppo"`: a shipped pilot (`ppo`, `waypoint-pid`), a file of weights that our
      training scripts wrote, a perception network (`WaypointNetwork`), or an SB3 model trained on
      `SADA-RacingTask-v0`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-UAV"
    render_fps = REPLAY_HZ
    steps_a_frame = POLICY_HZ // REPLAY_HZ
    fooling_threshold = 0.7
    sample_size = 100
    episodes_class = RacingEpisodes
    frame_module = "sada_gym.envs.uav.frame"
    behaviour_module = "sada_gym.envs.uav.behaviour"
    privileged_agent = "sada_gym.envs.uav.agent.pilot:PrivilegedPilot"
    worlds_at_once = 64

    def __init__(
        self,
        anchors: int = 3,
        *,
        agent: str | Path | PilotLike = "ppo",
        agent_id: str | None = None,
    ) -> None:
        self.template, self.anchors = template(anchors), int(anchors)
        self.parameters = self.template.parameters
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"anchors": self.anchors}

    def _as_agent(self, given: Any) -> Pilot:
        return as_pilot(given)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> RacingEpisodes:
        """Begin the races in the worlds of mu, n of them; close them after use."""
        tracks = self.template.tracks(mu)
        return RacingEpisodes(benchmark_starts(tracks, seeds), tracks)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = [], []
        for _, races in self._played(self.policy, mu, seeds):
            scores.append(races.score)
            tracks = races.tracks
            assert tracks is not None
            sharpest, closest = tracks.sharpest_turn_deg(), tracks.closest_m()
            for i, outcomes in enumerate(races.endings):
                extras.append(
                    {
                        "gates_passed": int((outcomes == GateOutcome.PASSED).sum()),
                        "endings": [GateOutcome(code).name.lower() for code in outcomes],
                        "time_s": float(races.time_s[i]),
                        "length_m": float(tracks.length_m[i]),
                        "sharpest_turn_deg": float(sharpest[i]),
                        "closest_m": float(closest[i]),
                        "kept": float(tracks.kept[i]),
                    }
                )
        return Scored(np.concatenate(scores), extras)
