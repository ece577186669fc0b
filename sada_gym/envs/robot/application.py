"""A robot under attack: floor, load, lidar, wheels and latency; Q is the share of goals reached."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.application import Scored
from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.envs.robot.episodes import RobotEpisodes
from sada_gym.envs.robot.start import PARAMETERS, POLICY_HZ, RobotEnd, RobotStart, conditions
from sada_gym.envs.robot.world.floor_plan import TRIPS, floor_plan
from sada_gym.parameters import Mu

PLANS = 2
"""The floor plans of one evaluation."""


class RobotApplication(SimulatorApplication[RobotEpisodes]):
    """A robot with a lidar makes ten trips through warehouses.

    ## Description
    The robot, a TurtleBot 2, knows the map of a warehouse and where it is, and follows a planned
    way to its goal. Barrels and moving carts are not on the map: it sees them with its lidar. The
    adversary sets the floor, the load, how the lidar is mounted and how well it works, how worn the
    wheels are, how many barrels stand about, and the latency of commands. The score Q is the share
    of ten trips (five on each of two floor plans) that reach their goal in time and touch nothing.
    The seed draws the floor plans and the lidar's noise. Rigid bodies and contacts are pymunk's.

    ## Action Space
    `Box(-1, 1, (10,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | friction between wheels and floor | 0.05 | 0.45 | |
    | 1 | payload | 0 | 5 | kg |
    | 2 | how far ahead of the axle the payload lies | -0.1 | 0.1 | m |
    | 3 | angle by which the lidar is turned to the left | -30 | 30 | deg |
    | 4 | how far to the left of the middle the lidar sits | -0.15 | 0.15 | m |
    | 5 | standard deviation of the lidar's ranges | 0 | 0.2 | m |
    | 6 | share of the lidar's rays that return nothing | 0 | 0.9 | |
    | 7 | the right wheel turns faster by this share, the left one slower | -0.18 | 0.18 | |
    | 8 | barrels in 10 m² of the hall | 0 | 2 | |
    | 9 | latency of commands | 0 | 0.6 | s |

    `ppo` was trained in the middle of all ranges, `ppo-randomised` in the middle quarter of each.

    ## Observation Space
    `Box(-1, 1, (12,), float32)`: last mu (0 to 9), last score (10), share of the steps left (11);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of arrivals.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.6, as in the SADA paper's self-driving, where Q is a share of trips,
    too), `seed`, `parameters`, `endings` (for each trip `arrived`, `collided` or `too_late`) and
    `remaining_m` (what was left of each way).

    ## Arguments
    - `agent="ppo"`: a shipped robot (`ppo`, `ppo-randomised`), a file of weights that our training
      script wrote, or an SB3 model trained on `SADA-RobotTask-v0`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Robot"
    render_fps = POLICY_HZ
    frames_tell_values = True
    fooling_threshold = 0.6
    sample_size = 100
    parameters = PARAMETERS
    episodes_class = RobotEpisodes
    frame_module = "sada_gym.envs.robot.frame"
    behaviour_module = "sada_gym.envs.robot.behaviour"
    privileged_agent = "sada_gym.envs.robot.agent.privileged:PrivilegedDriver"
    worlds_at_once = 128

    def __init__(
        self,
        *,
        agent: AgentLike = "ppo",
        agent_id: str | None = None,
    ) -> None:
        super().__init__(agent, agent_id)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> RobotEpisodes:
        """Begin all trips in the worlds of mu, ten each: (10 n) of them."""
        starts = []
        for row, seed in zip(mu, seeds, strict=True):
            drawn = np.random.SeedSequence(seed).generate_state(PLANS + PLANS * TRIPS, np.uint64)
            numbers = (drawn >> 1).tolist()
            physics = conditions(row)
            for k in range(PLANS):
                plan = floor_plan(numbers[k])
                starts += [
                    RobotStart(plan, trip, physics, numbers[PLANS + k * TRIPS + trip])
                    for trip in range(TRIPS)
                ]
        return RobotEpisodes(starts)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = [], []
        for worlds, trips in self._played(self.policy, mu, seeds):
            shape = (len(mu[worlds]), -1)
            scores.append(trips.score.reshape(shape).mean(axis=1))
            remaining_m = trips.remaining_m.reshape(shape)
            extras += [
                {"endings": [RobotEnd(code).name.lower() for code in codes], "remaining_m": row}
                for codes, row in zip(trips.ending.reshape(shape), remaining_m, strict=True)
            ]
        return Scored(np.concatenate(scores), extras)
