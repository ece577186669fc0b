"""A quadrotor under attack: build, load, wind, sensors, speed; Q is the share of time on course."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sada_gym.agents.packaged import missing_packages
from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.envs.quadrotor.card import CARD
from sada_gym.envs.quadrotor.episodes import FILM_STEPS, QuadrotorEpisodes
from sada_gym.envs.quadrotor.start import PARAMETERS, POLICY_HZ, QuadrotorStart
from sada_gym.parameters import Mu


class QuadrotorApplication(SimulatorApplication[QuadrotorEpisodes]):
    """A third-party recurrent policy flies a quadrotor along a figure of eight.

    ## Description
    The pilot is RAPTOR, one small recurrent network that its authors trained to fly any quadrotor
    of 20 g to 5 kg, and that PX4 has as a module. At 100 Hz it gets position, attitude, velocity
    and body rates, and sets the speeds of the four motors. The adversary changes a Crazyflie or a
    Holybro X500 within the ranges of RAPTOR's training, shifts its centre of mass, weakens a motor,
    and sets the wind, the noise and age of what is observed, and the reference's speed. The
    reference is 1.5 m above the ground. It stands still first, gets faster for 3 s, and flies a
    figure of eight, 2 m by 1 m. The score Q is the share of the flight, from its third second to
    its tenth, in which the quadrotor is at most 0.3 m from the reference; it is 0 where the
    quadrotor hits the ground or gets 3 m away. The seed draws where it starts (up to 0.3 m away
    along each axis, tilted by up to 20° about two), the gusts and the noise.

    ## Action Space
    `Box(-1, 1, (14,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | mass, as a multiple of the platform's | 0.7 | 1.5 | |
    | 1 | distance of the motors from the middle, likewise | 0.77 | 1.3 | |
    | 2 | thrust of all motors over the weight | 1.5 | 5 | |
    | 3 | turning acceleration that one motor at full throttle gives | 40 | 1200 | 1/s² |
    | 4 | time constant of a motor that goes faster | 0.03 | 0.1 | s |
    | 5 | time constant of a motor that goes slower | 0.03 | 0.3 | s |
    | 6 | how far ahead of the middle the centre of mass lies, in arms | -0.1 | 0.1 | |
    | 7 | how far to the left of the middle it lies, in arms | -0.1 | 0.1 | |
    | 8 | share of its thrust that the front right motor lacks | 0 | 0.2 | |
    | 9 | steady wind along x | 0 | 5 | m/s |
    | 10 | standard deviation of gusts along each axis | 0 | 2 | m/s |
    | 11 | standard deviation of the observed position | 0 | 0.02 | m |
    | 12 | age of what is observed | 0 | 0.01 | s |
    | 13 | greatest speed of the reference | 0 | 2 | m/s |

    ## Observation Space
    `Box(-1, 1, (16,), float32)`: last mu (0 to 13), last score (14), share of the steps left (15);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of time on course.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.7), `seed`, `parameters`, `ending` (`flown`, `crashed` or `lost`),
    `flown_s`, `upset` (whether it was ever upside down), `far_m` (the greatest distance from the
    reference after the first two seconds) and `turning_rad_s` (the mean body rate).

    ## Arguments
    - `platform="crazyflie"`: `crazyflie` (31 g) or `x500` (2 kg); each has an id of its own, such
      as `SADA-Quadrotor-X500-v0`.
    - `agent="raptor"`: the policy in the package `foundation-policy`, an SB3 model with the spaces
      of `QuadrotorEpisodes`, or an agent of your own with `fingerprint`, `start` and `act`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Quadrotor"
    render_fps = POLICY_HZ // FILM_STEPS
    steps_a_frame = FILM_STEPS
    frames_tell_values = True
    fooling_threshold = 0.7
    sample_size = 100
    parameters = PARAMETERS
    episodes_class = QuadrotorEpisodes
    frame_module = "sada_gym.envs.quadrotor.frame"
    behaviour_module = "sada_gym.envs.quadrotor.behaviour"
    worlds_at_once = 128

    def __init__(
        self,
        platform: str = "crazyflie",
        *,
        agent: AgentLike = "raptor",
        agent_id: str | None = None,
    ) -> None:
        self.platform = QuadrotorStart(platform, {}, 0).platform
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"platform": self.platform}

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> QuadrotorEpisodes:
        """Begin the flights in the worlds of mu, n of them."""
        return QuadrotorEpisodes(
            [
                QuadrotorStart(self.platform, PARAMETERS.describe(row), seed)
                for row, seed in zip(mu, seeds, strict=True)
            ]
        )


def missing() -> str:
    """Say what has to be installed for RAPTOR; empty where all is there."""
    return missing_packages({**CARD.packaged[0].needs, "h5py": ""})
