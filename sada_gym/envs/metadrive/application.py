"""MetaDrive under attack: road, traffic, sensors and car; Q is the share of the route done."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.envs.metadrive.episodes import UNFINISHED, DriveEpisodes
from sada_gym.envs.metadrive.start import (
    NOMINAL,
    PARAMETERS,
    POLICY_HZ,
    SCENES,
    TRAINING_SCENES,
    DriveStart,
)
from sada_gym.envs.metadrive.world.engine import check_installed
from sada_gym.parameters import Mu


class MetaDriveApplication(SimulatorApplication[DriveEpisodes]):
    """A third-party driver follows a route in MetaDrive, among other cars.

    ## Description
    MetaDrive is a simulator of driving that its authors wrote for reinforcement learning (Li et al.
    2021); `metadrive-expert` is the PPO driver inside its package. At 10 Hz the driver gets the
    car's state, the next checkpoints of its route, the four nearest cars and a lidar of 240 rays,
    and sets steering, throttle and brake. The road is a straight of 50 m, a block that the seed
    draws (a crossing, a roundabout, a ramp, a straight or a curve), and a curve. The adversary sets
    the traffic and its manners, accidents and roadworks, the road, the lidar and the car. The score
    Q is the share of the route that was done when the car arrived (1), hit something, left its
    road, or was late; without an arrival it is 0.9 at most. The seed draws the scene (map, traffic,
    accidents), what other drivers want, and the lidar's noise. MetaDrive runs without pictures,
    and its assets are never downloaded.

    ## Action Space
    `Box(-1, 1, (15,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | cars on each 10 m of a lane | 0 | 0.2 | |
    | 1 | probability of an accident or roadworks on a block | 0 | 0.8 | |
    | 2 | probability that the block is a crossing or a roundabout | 0 | 1 | |
    | 3 | radius of curves | 25 | 60 | m |
    | 4 | width of a lane | 3 | 4.5 | m |
    | 5 | lanes in each direction: 2 or 3 | 1.5 | 3.5 | |
    | 6 | speed that other drivers want | 20 | 50 | km/h |
    | 7 | standard deviation of it among them | 0 | 10 | km/h |
    | 8 | time gap that other drivers keep | 0.5 | 2 | s |
    | 9 | gap in which other drivers change lanes | 3 | 15 | m |
    | 10 | standard deviation of the lidar's ranges | 0 | 1 | m |
    | 11 | share of the lidar's rays that return nothing | 0 | 0.5 | |
    | 12 | mass of the car | 1000 | 1600 | kg |
    | 13 | its brakes, MetaDrive's `max_brake_force` | 80 | 180 | |
    | 14 | latency of commands | 0 | 0.2 | s |

    ## Observation Space
    `Box(-1, 1, (17,), float32)`: last mu (0 to 14), last score (15), share of the steps left (16);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of the route.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.9: the car did not arrive), `seed`, `parameters`, `ending` (`arrived`,
    `hit_car`, `hit_object`, `left_road` or `too_late`), `route_done`, `after_s` and `speed_km_h`
    (just before the end).

    ## Arguments
    - `agent="metadrive-expert"`: MetaDrive's own expert, its rule-based driver `metadrive-idm`, a
      file of weights that our training script wrote, an SB3 model trained on
      `SADA-DrivingMetaDriveTask-v0`, or an agent of your own with `fingerprint`, `start`, `act`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-DrivingMetaDrive"
    render_fps = POLICY_HZ
    frames_tell_values = True
    fooling_threshold = UNFINISHED
    sample_size = 100
    parameters = PARAMETERS
    nominal = PARAMETERS.normalised(np.array([*NOMINAL.values()]))
    episodes_class = DriveEpisodes
    frame_module = "sada_gym.envs.metadrive.frame"
    behaviour_module = "sada_gym.envs.metadrive.behaviour"
    privileged_agent = "sada_gym.envs.metadrive.agent.idm:CarefulDriver"
    worlds_at_once = 1

    def __init__(
        self, *, agent: AgentLike = "metadrive-expert", agent_id: str | None = None
    ) -> None:
        check_installed()
        super().__init__(agent, agent_id)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> DriveEpisodes:
        """Begin the drive in the world of one mu, (1, d)."""
        starts = []
        for row, seed in zip(mu, seeds, strict=True):
            scene, number = np.random.SeedSequence(seed).generate_state(2).tolist()
            scene = TRAINING_SCENES + scene % (SCENES - TRAINING_SCENES)
            starts.append(DriveStart(PARAMETERS.describe(row), scene, number))
        return DriveEpisodes(starts)
