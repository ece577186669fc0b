"""An aeroplane under attack: load, speed, air, ice, servos; Q is the share of time on command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sada_gym.agents.packaged import missing_packages, package_files
from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.envs.flight.card import CARD
from sada_gym.envs.flight.episodes import FlightEpisodes
from sada_gym.envs.flight.start import NOMINAL, PARAMETERS, FlightStart
from sada_gym.parameters import Mu


class FlightApplication(SimulatorApplication[FlightEpisodes]):
    """The autopilot of an aircraft in JSBSim climbs and turns as commanded, and holds that.

    ## Description
    JSBSim, the flight dynamics that FlightGear and industry use, brings the aircraft and, in their
    own files, their autopilots, which others made: a Cessna 172P, a Cessna 310 and a
    Bombardier Global 5000. A flight of two minutes begins in level flight at 5,000 ft, heading
    east. After 10 s the autopilot is given another altitude and another heading. The crew holds the
    airspeed by the throttle and does nothing else. The adversary sets the load, the air, ice, the
    manoeuvre and faults of the autopilot's servos. The score Q is the share of the last 40 s in
    which altitude and heading are within 100 ft and 10° of what is commanded; it is 0 after a
    stall, an upset (bank over 45°, nose over 25° up or 10° down) or beyond the never-exceed speed.
    The seed draws the turbulence.

    ## Action Space
    `Box(-1, 1, (13,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | payload, from a crew alone to the greatest take-off weight | 0 | 1 | |
    | 1 | centre of gravity, from the forward limit to the aft limit | 0 | 1 | |
    | 2 | airspeed, from the aircraft's lowest to its highest here | 0 | 1 | |
    | 3 | temperature, compared with the standard atmosphere | -20 | 20 | K |
    | 4 | commanded turn, to the right | -90 | 90 | ° |
    | 5 | commanded climb | -300 | 300 | ft |
    | 6 | turbulence by MIL-F-8785C, a whole number: 3 is light, 4 moderate | 0 | 4 | |
    | 7 | tailwind that rises within 20 s after the command | -30 | 30 | kt |
    | 8 | downdraught that rises likewise | -1000 | 1000 | ft/min |
    | 9 | share of the lift that ice takes, from the 30th second | 0 | 0.3 | |
    | 10 | share of the drag that ice adds, likewise | 0 | 0.4 | |
    | 11 | time that the servos take from stop to stop | 0.5 | 3 | s |
    | 12 | time for which the pitch servo sticks, from the command | 0 | 4 | s |

    ## Observation Space
    `Box(-1, 1, (15,), float32)`: last mu (0 to 12), last score (13), share of the steps left (14);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of time on command.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.7), `seed`, `parameters`, `ending` (`flown`, `stalled`, `upset`,
    `overspeed` or `invalid`), `flown_s`, `altitude_error_ft` and `heading_error_deg` (the greatest
    of the last 40 s), `speed_kt` (at the end) and `invalid` (why JSBSim could not compute the
    world, such as a trim that it did not find; empty otherwise).

    ## Arguments
    - `aircraft="c172"`: `c172`, `c310` or `global5000`; each has an id of its own, such as
      `SADA-Flight-C310-v0`.
    - `agent="built-in"`: the autopilot, an SB3 model with the spaces of `FlightEpisodes`, or an
      agent of your own with `fingerprint`, `start` and `act`; the autopilot is then off.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Flight"
    render_fps = 10  # a film is ten times as fast as the flight
    steps_a_frame = 4
    frames_tell_values = True
    fooling_threshold = 0.7
    sample_size = 100
    parameters = PARAMETERS
    nominal = NOMINAL
    episodes_class = FlightEpisodes
    frame_module = "sada_gym.envs.flight.frame"
    behaviour_module = "sada_gym.envs.flight.behaviour"
    worlds_at_once = 1  # side by side they push one another out of the cache

    def __init__(
        self,
        aircraft: str = "c172",
        *,
        agent: AgentLike = "built-in",
        agent_id: str | None = None,
    ) -> None:
        package_files(CARD.packaged[0])  # the world is in them, whoever flies
        self.aircraft = FlightStart(aircraft, {}, 0).aircraft
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"aircraft": self.aircraft}

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> FlightEpisodes:
        """Begin the flights in the worlds of mu, n of them."""
        return FlightEpisodes(
            [
                FlightStart(self.aircraft, PARAMETERS.describe(row), seed)
                for row, seed in zip(mu, seeds, strict=True)
            ]
        )


def missing() -> str:
    """Say what has to be installed for JSBSim; empty where all is there."""
    return missing_packages(CARD.packaged[0].needs)
