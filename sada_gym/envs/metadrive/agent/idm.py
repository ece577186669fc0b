"""MetaDrive's IDM driver, and one that also brakes as UN Regulation 157 expects of a human."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.envs.metadrive.start import POLICY_HZ
from sada_gym.foundations.arrays import Floats, Indices

WANDERING_M, RISK_TTC_S = 0.375, 2.0
"""A car that is further from the middle of its lane is seen to leave it; a collision that is nearer
is a risk."""
PERCEPTION_S, DELAY_S, RAMP_S, BRAKING_M_S2 = 0.4, 0.75, 0.6, 0.774 * 9.81
"""UN Regulation 157, Annex 4, Appendix 3: the time to perceive a risk, from then to the brake, and
to full deceleration, and that deceleration."""
_BRAKES = 200.0
"""MetaDrive's deceleration in m/s² for each unit of brake force over mass: four wheels, 0.02 s."""
_CROSSING_RAD = math.radians(30.0)


class Idm:
    """The driver with which MetaDrive moves its traffic: it knows what is near, not by lidar.

    Args:
        source: The SHA-256 of the file that defines it.
    """

    def __init__(self, source: str) -> None:
        self.fingerprint = source
        self.start(0)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the drive under way."""
        return {**self.__dict__, "_policy": None, "_world": -1}

    def start(self, count: int) -> None:  # noqa: ARG002 - as agents have it
        """Begin new drives."""
        self._policy: Any = None
        self._world = -1

    def act(self, episodes: DriveEpisodes, which: Indices) -> Floats:
        """Return the actions (n, 2) in some of the drives."""
        from metadrive.policy.idm_policy import IDMPolicy

        car = episodes.car
        if self._world != episodes.world:
            self._world = episodes.world
            self._policy = IDMPolicy(car, episodes.starts[0].scene)
        action = np.clip(self._policy.act(), -1.0, 1.0)
        return np.repeat(action[None], len(which), axis=0)


def load(files: Mapping[str, Path]) -> Idm:
    """Return the IDM of the installed package, which is code."""
    return Idm(hashlib.sha256(b"".join(path.read_bytes() for path in files.values())).hexdigest())


class CarefulDriver(Idm):
    """The IDM, with the reaction of UN Regulation 157's competent and careful human driver.

    It perceives a risk where, at constant speeds, its body would meet another within 2 s. It counts
    a car beside it only from where that car leaves the middle of its lane.
    """

    def __init__(self) -> None:
        super().__init__("IDM, and UN R157")

    def start(self, count: int) -> None:
        """Begin new drives."""
        super().start(count)
        self._since = 0  # steps since a risk has been there

    def act(self, episodes: DriveEpisodes, which: Indices) -> Floats:
        """Return the actions (n, 2) in some of the drives."""
        new = self._world != episodes.world
        actions = super().act(episodes, which)
        risk = _time_to_collision(episodes, self._policy.routing_target_lane) <= RISK_TTC_S
        self._since = 0 if new or not risk else self._since + 1
        braking_s = self._since / POLICY_HZ - PERCEPTION_S - DELAY_S
        if braking_s > 0.0:
            now = episodes.starts[0].conditions
            wanted = BRAKING_M_S2 * min(braking_s / RAMP_S, 1.0)
            pedal = min(wanted * now["mass_kg"] / (_BRAKES * now["brake_force"]), 1.0)
            actions[:, 1] = np.minimum(actions[:, 1], -pedal)
        return actions


def _time_to_collision(episodes: DriveEpisodes, lane: Any) -> float:
    """Return the time until bodies meet at constant speeds along and across a lane, or inf."""
    car, soonest = episodes.car, math.inf
    at, _ = lane.local_coordinates(car.position)
    times = np.arange(0.0, RISK_TTC_S + 0.05, 0.1)
    for thing in car.lidar.get_surrounding_objects(car):
        along, aside = lane.local_coordinates(thing.position)
        turned = thing.heading_theta - lane.heading_theta_at(min(max(along, 0.0), lane.length))
        cos, sin = math.cos(turned), math.sin(turned)
        ahead, across = thing.speed * cos, thing.speed * sin
        if abs(sin) < math.sin(_CROSSING_RAD) and thing.lane is not None:
            own = thing.lane.local_coordinates(thing.position)[1]
            across = across if abs(own) > WANDERING_M else 0.0
        length, width = thing.LENGTH or 1.0, thing.WIDTH or 1.0
        gap = np.abs(along - at + (ahead - car.speed) * times)
        lateral = np.abs(aside + across * times)
        reach = (abs(length * cos) + abs(width * sin) + car.LENGTH) / 2
        breadth = (abs(length * sin) + abs(width * cos) + car.WIDTH) / 2
        meets = (gap < reach) & (lateral < breadth)
        if along > at and meets.any():
            soonest = min(soonest, float(times[meets.argmax()]))
    return soonest
