"""The flight: aircraft of JSBSim, their autopilots and the scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.flight.application import FlightApplication

__all__ = ["FlightApplication"]

__getattr__ = lazy_names(__name__, {"FlightApplication": "application"})
