"""How a drive in MetaDrive begins: its conditions, which the adversary sets; in training too."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from sada_gym.envs.checks import bounded, check_bounds
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Parameter, ParameterSpace

PARAMETERS = ParameterSpace(
    Parameter("traffic_density", 0.0, 0.2, unit="1/10 m"),
    Parameter("accident_prob", 0.0, 0.8),
    Parameter("junctions", 0.0, 1.0),
    Parameter("curve_radius_m", 25.0, 60.0, unit="m"),
    Parameter("lane_width_m", 3.0, 4.5, unit="m"),
    Parameter("lanes", 1.5, 3.5, whole=True),
    Parameter("traffic_speed_km_h", 20.0, 50.0, unit="km/h"),
    Parameter("traffic_spread_km_h", 0.0, 10.0, unit="km/h"),
    Parameter("traffic_gap_s", 0.5, 2.0, unit="s"),
    Parameter("cut_in_gap_m", 3.0, 15.0, unit="m"),
    Parameter("lidar_noise_m", 0.0, 1.0, unit="m"),
    Parameter("lidar_dropout", 0.0, 0.5),
    Parameter("mass_kg", 1000.0, 1600.0, unit="kg"),
    Parameter("brake_force", 80.0, 180.0),
    Parameter("latency_s", 0.0, 0.2, unit="s"),
)

NOMINAL = dict(
    zip(
        PARAMETERS.names,
        map(float, (0, 0, 0.4, 42.5, 3.5, 3, 30, 0, 1.5, 15, 0, 0, 1100, 150, 0)),
        strict=True,
    )
)
"""MetaDrive's own values, on an empty road, where its authors test that their expert arrives."""

POLICY_HZ = 10
SCENES = 65_536
"""The scenes that a seed can draw: as many as MetaDrive's own generators have seeds."""
TRAINING_SCENES = 5_000
"""The scenes of the training have the numbers below this. The benchmark draws from the others."""


class DriveEnd(IntEnum):
    """How a drive ended."""

    UNDER_WAY = 0
    ARRIVED = 1
    HIT_CAR = 2
    HIT_OBJECT = 3
    LEFT_ROAD = 4
    TOO_LATE = 5

    @property
    def words(self) -> str:
        """Say so."""
        return _WORDS[self]


_WORDS = ("", "arrived", "hit a car", "hit an object on the road", "left its road", "too late")


@dataclass(frozen=True)
class DriveStart:
    """How one drive begins.

    Attributes:
        conditions: The physical values of all parameters.
        scene: The scene of MetaDrive, below `SCENES`: it fixes the map and the traffic.
        seed: Fixes the lidar's noise and what drivers want.
        roads: What the episodes add for pictures: the outline of each lane, (points, 2), and
            whether it is on the route.
    """

    conditions: dict[str, float] = field(default_factory=lambda: dict(NOMINAL))
    scene: int = 0
    seed: int = 0
    roads: tuple[tuple[Floats, bool], ...] = field(default=(), repr=False, compare=False)


@dataclass(frozen=True)
class DriveDistribution:
    """A distribution of drives, for training.

    Attributes:
        spread: Each condition is drawn from this share of its range, around its middle.
        empty: The share of nominal drives, on an empty road.
        latency_s: The end of the range of latencies, which is wider than the adversary's.
    """

    spread: float = bounded(0.0, 1.0, 0.5)
    empty: float = bounded(0.0, 1.0, 0.5)
    latency_s: float = bounded(0.0, 0.5, 0.5)

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> DriveStart:
        """Draw one drive."""
        drawn = dict(NOMINAL)
        if rng.random() >= self.empty and self.spread > 0.0:
            mu = rng.uniform(-self.spread, self.spread, len(PARAMETERS)).astype(np.float32)
            drawn = PARAMETERS.describe(mu)
            drawn["latency_s"] = self.latency_s * (float(mu[-1]) + 1.0) / 2.0
        return DriveStart(drawn, int(rng.integers(TRAINING_SCENES)), int(rng.integers(2**31)))
