"""How a flight begins: the aircraft, the conditions that the adversary sets, and the seed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from sada_gym.errors import check_known
from sada_gym.parameters import Parameter, ParameterSpace

PARAMETERS = ParameterSpace(
    Parameter("payload", 0.0, 1.0),
    Parameter("balance", 0.0, 1.0),
    Parameter("speed", 0.0, 1.0),
    Parameter("temperature_k", -20.0, 20.0, unit="K"),
    Parameter("turn_deg", -90.0, 90.0, unit="deg"),
    Parameter("climb_ft", -300.0, 300.0, unit="ft"),
    Parameter("turbulence", -0.5, 4.5, whole=True),
    Parameter("tailwind_kt", -30.0, 30.0, unit="kt"),
    Parameter("downdraught_ft_min", -1_000.0, 1_000.0, unit="ft/min"),
    Parameter("lost_lift", 0.0, 0.3),
    Parameter("added_drag", 0.0, 0.4),
    Parameter("servo_s", 0.5, 3.0, unit="s"),
    Parameter("stuck_s", 0.0, 4.0, unit="s"),
)

NOMINAL = PARAMETERS.normalised(
    [0.5, 0.5, 0.6, 0.0, 45.0, 150.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
)
"""Ordinary use: half loaded, cruising, in turbulence that is exceeded in a tenth of the time."""

START_FT = 5_000.0
START_DEG = 90.0
"""The altitude and the heading at the start."""
POLICY_HZ = 4
"""Agents act, and flights are judged, at this rate."""
COMMAND_S, SETTLED_S, FLIGHT_S = 10, 80, 120
"""When the manoeuvre is commanded, when it must be over, and when the flight ends."""
WITHIN_FT, WITHIN_DEG = 100.0, 10.0
"""How near to the commanded altitude and heading counts as held."""


class FlightEnd(IntEnum):
    """How a flight ended."""

    UNDER_WAY = 0
    FLOWN = 1
    STALLED = 2
    UPSET = 3
    OVERSPEED = 4
    INVALID = 5


class Aircraft(NamedTuple):
    """An aircraft of JSBSim, and how its manual lets it be flown."""

    title: str
    model: str
    masses: int  # the file's point masses: the first becomes the load, the others are emptied
    crew_lb: float
    most_lb: float  # the greatest weight at take-off
    forward_in: tuple[tuple[float, float], ...]  # the forward limit of the centre of gravity, by lb
    aft_in: float  # the aft limit
    speed_kt: tuple[float, float]  # calibrated
    never_kt: float
    stall_deg: float  # the angle of attack of the greatest lift in the file
    engines: int
    roll: str  # what the autopilot's command for the ailerons is called
    engage: tuple[str, ...]  # the autopilot's switches
    advance: float = 1.0  # the propellers' levers
    trims: bool = True  # JSBSim's trim stops the C310's engines


_BY_HEADING = "guidance/heading-selector-switch"
AIRCRAFT = {
    "c172": Aircraft(
        *("Cessna 172P", "c172x", 6, 170.0, 2_400.0, ((1_950.0, 35.0), (2_400.0, 39.5)), 47.3),
        *((70.0, 105.0), 158.0, 16.0, 1, "ap/roll-cmd-norm-output"),
        ("ap/altitude_hold", "ap/roll-attitude-mode", "ap/autopilot-roll-on", _BY_HEADING),
    ),
    "c310": Aircraft(
        *("Cessna 310", "c310", 5, 170.0, 4_830.0, ((4_830.0, 42.0),), 47.0),
        *((110.0, 165.0), 223.0, 14.0, 2, "ap/aileron_cmd"),
        ("ap/altitude_hold", "ap/heading_hold"),
        advance=0.7,
        trims=False,
    ),
    "global5000": Aircraft(
        *("Global 5000", "global5000", 1, 600.0, 87_700.0, ((87_700.0, 777.6),), 804.0),
        *((190.0, 250.0), 300.0, 13.2, 2, "ap/aileron_cmd"),
        ("ap/altitude_hold", "ap/heading_hold"),
    ),
}


@dataclass(frozen=True)
class FlightStart:
    """How one flight begins."""

    aircraft: str
    conditions: dict[str, float]  # the physical values of all parameters
    seed: int  # fixes the turbulence

    def __post_init__(self) -> None:
        """Check the aircraft."""
        check_known("aircraft", [self.aircraft], [*AIRCRAFT])

    @property
    def built(self) -> Aircraft:
        """The aircraft's figures."""
        return AIRCRAFT[self.aircraft]

    @property
    def speed_kt(self) -> float:
        """The calibrated airspeed at the start."""
        low, high = self.built.speed_kt
        return low + self.conditions["speed"] * (high - low)

    @property
    def altitude_ft(self) -> float:
        """The commanded altitude."""
        return START_FT + self.conditions["climb_ft"]

    @property
    def heading_deg(self) -> float:
        """The commanded heading."""
        return START_DEG + self.conditions["turn_deg"]
