"""A robot dog under attack: ground, load, push, motors, command; Q is the share of the way done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sada_gym import agents
from sada_gym.agents.packaged import missing_packages
from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.envs.go2.episodes import FILM_STEPS, Go2Episodes
from sada_gym.envs.go2.start import FOOLED, PARAMETERS, POLICY_HZ, Go2Start
from sada_gym.errors import FileError, MissingPart
from sada_gym.foundations.frames import Take
from sada_gym.parameters import Mu

ORDINARY = {
    **{"friction": 0.786, "motor_lag_s": 0.0151, "motor_strength": 1.0, "speed_m_s": 0.8},
    **dict.fromkeys(("slope_deg", "step_height_m", "payload_kg", "payload_ahead_m"), 0.0),
    **dict.fromkeys(("payload_left_m", "push_m_s", "push_direction_deg"), 0.0),
    **dict.fromkeys(("turn_rad_s", "delay_s"), 0.0),
}
"""The world in which the physics were fitted, on flat ground."""


class Go2Application(SimulatorApplication[Go2Episodes]):
    """A third-party walking policy leads a robot dog along a commanded way.

    ## Description
    The robot is a Unitree Go2 in MuJoCo, with physics that others fitted to runs of a real one. Its
    walker is a policy of rl_sar's authors, which runs on real robots: it feels its joints, how the
    trunk turns and where down is, and sees nothing. At 50 Hz it sets targets of the twelve joints.
    A loop around it trims its command so that the robot's own velocity keeps to it. The adversary
    sets the ground, the load, a push, the motors and the command. The score Q is the share of the
    commanded way that is done after 6 s: the way, a line or an arc, is searched for the place that
    is nearest to the robot. After a fall (the trunk tilts by more than 60 degrees) Q is 0. The seed
    draws the joints at the start (up to 0.1 rad from the usual pose), the shape of the ground
    (slabs across the way, 0.3 to 0.6 m deep, with heights of 0 to 1 times the step height), and
    when the push comes (2 to 4 s).

    ## Action Space
    `Box(-1, 1, (13,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | friction between feet and ground | 0.3 | 1 | |
    | 1 | slope of the ground, uphill ahead | -20 | 20 | deg |
    | 2 | the greatest height of slabs of the ground | 0 | 0.1 | m |
    | 3 | payload on the back | 0 | 8 | kg |
    | 4 | how far ahead of the trunk's middle the payload lies | -0.19 | 0.19 | m |
    | 5 | how far to its left | -0.05 | 0.05 | m |
    | 6 | push of 0.2 s: the change of speed that it would give in the air | 0 | 2 | m/s |
    | 7 | where the push drives the robot: 0 is ahead, 90 to the left | -180 | 180 | deg |
    | 8 | time constant of the motors' torques | 0.01 | 0.02 | s |
    | 9 | strength of the motors | 0.7 | 1.3 | |
    | 10 | commanded speed | 0.3 | 1 | m/s |
    | 11 | commanded turn, to the left | -1 | 1 | rad/s |
    | 12 | age of what is observed | 0 | 0.01 | s |

    The world in ordinary use (`nominal`) is the one of the fit: flat, with friction 0.786 and a
    time constant of 15.1 ms, without load, push and delay, at 0.8 m/s straight ahead.

    ## Observation Space
    `Box(-1, 1, (15,), float32)`: last mu (0 to 12), last score (13), share of the steps left (14);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of the way that is done.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.6), `seed`, `parameters`, `ending` (`walked`, `fell` or `broken`),
    `walked_s`, `done` (the share of the way, after a fall too), `x_m`, `y_m` and `height_m` of the
    trunk at the end, and `invalid` (what MuJoCo warned of: such a world is no failure).

    ## Arguments
    - `agent="go2-walk"`: the policy that `sada-gym fetch go2-walk` gets, `onnx:FILE` for a policy
      of your own with the same layout, an SB3 model with the spaces of `Go2Episodes`, or an agent
      with `fingerprint`, `start` and `act`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Go2"
    render_fps = POLICY_HZ // FILM_STEPS
    steps_a_frame = FILM_STEPS
    frames_tell_values = True
    fooling_threshold = FOOLED
    sample_size = 100
    parameters = PARAMETERS
    nominal = PARAMETERS.normalised(np.array([ORDINARY[name] for name in PARAMETERS.names]))
    episodes_class = Go2Episodes
    frame_module = "sada_gym.envs.go2.frame"
    behaviour_module = "sada_gym.envs.go2.behaviour"
    worlds_at_once = 16

    def __init__(self, *, agent: AgentLike = "go2-walk", agent_id: str | None = None) -> None:
        if sentence := missing():
            raise MissingPart(sentence)
        super().__init__(agent, agent_id)

    @property
    def seconds_per_world(self) -> float:
        """About how many seconds a world takes."""
        return 0.4

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> Go2Episodes:
        """Begin the walks in the worlds of mu, n of them."""
        return Go2Episodes(
            [Go2Start(PARAMETERS.describe(row), seed) for row, seed in zip(mu, seeds, strict=True)]
        )

    def _take(self, rollouts: list[Rollout[Any]], i: int) -> Take:
        failed = rollouts[i].score <= FOOLED  # the last centimetres of a way are no failure
        return replace(super()._take(rollouts, i), failed=failed)


def missing() -> str:
    """Say what has to be installed or fetched before the ids work; empty where all is there."""
    sentences = [missing_packages({"mujoco": ""})]
    try:
        agents.check_agent("go2-walk", Go2Application.name)
    except FileError as error:
        sentences.append(str(error))
    return " ".join(filter(None, sentences))
