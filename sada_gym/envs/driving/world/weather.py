"""Six weathers under CARLA's names, as the light, the sky, the air and the road that they make.

The numbers are ours, chosen by eye. Light is linear RGB. Weather changes what the camera sees; the
vehicle's grip stays the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sada_gym.envs.pixels import Triple
from sada_gym.errors import UserError


class Light(NamedTuple):
    """The light, the air and the water of one weather, for the pixel kernels."""

    sun_x: float  # towards the sun, a unit vector; z is upwards
    sun_y: float
    sun_z: float
    sun: Triple  # the sun's light on a surface that faces it
    ambient: Triple  # the light from everywhere
    zenith: Triple  # the colour of the sky overhead
    horizon: Triple  # the colour of the sky low down, and of the haze
    cloud: Triple  # the colour of clouds
    cover: float  # the share of the sky that clouds fill
    haze: float  # the rate per m at which things fade into the haze
    wetness: float  # the amount of water on the road, from 0 to 1
    rain: float  # the strength of the rain, from 0 to 1


def _toward(elevation_deg: float, azimuth_deg: float) -> Triple:
    elevation, azimuth = np.deg2rad([elevation_deg, azimuth_deg])
    flat = np.cos(elevation)
    return float(flat * np.cos(azimuth)), float(flat * np.sin(azimuth)), float(np.sin(elevation))


_NOON, _EVENING = _toward(62.0, 35.0), _toward(9.0, 200.0)

WEATHERS = {
    "ClearNoon": Light(
        *_NOON, (1.75, 1.66, 1.50), (0.40, 0.46, 0.58),
        (0.13, 0.30, 0.72), (0.62, 0.76, 0.95), (1.0, 1.0, 1.0), 0.15, 0.0010, 0.0, 0.0,
    ),
    "WetNoon": Light(
        *_NOON, (1.55, 1.48, 1.36), (0.42, 0.48, 0.58),
        (0.17, 0.33, 0.70), (0.66, 0.77, 0.92), (0.95, 0.96, 1.0), 0.4, 0.0020, 0.75, 0.0,
    ),
    "HardRainNoon": Light(
        *_NOON, (0.10, 0.10, 0.10), (0.40, 0.43, 0.47),
        (0.24, 0.26, 0.29), (0.40, 0.42, 0.45), (0.30, 0.32, 0.35), 1.0, 0.0130, 1.0, 1.0,
    ),
    "ClearSunset": Light(
        *_EVENING, (2.1, 1.05, 0.42), (0.30, 0.26, 0.34),
        (0.17, 0.20, 0.46), (1.15, 0.56, 0.22), (0.95, 0.50, 0.34), 0.25, 0.0022, 0.0, 0.0,
    ),
    "WetCloudyNoon": Light(
        *_NOON, (0.25, 0.25, 0.24), (0.68, 0.71, 0.75),
        (0.52, 0.56, 0.62), (0.74, 0.77, 0.80), (0.60, 0.63, 0.68), 1.0, 0.0028, 0.75, 0.0,
    ),
    "SoftRainSunset": Light(
        *_EVENING, (0.20, 0.10, 0.06), (0.34, 0.27, 0.28),
        (0.24, 0.20, 0.26), (0.56, 0.36, 0.26), (0.30, 0.23, 0.25), 1.0, 0.0065, 0.85, 0.4,
    ),
}  # fmt: skip
"""The weathers in the order of the parameter's axis: four of training, then two unseen ones."""

TRAINING_WEATHERS = 4

NAMES = tuple(WEATHERS)
LIGHTS = tuple(WEATHERS.values())


def weather_index(name: str) -> int:
    """Look a weather up by name; raise `UserError` if there is none."""
    if name not in NAMES:
        raise UserError(f"Expected a weather among {', '.join(NAMES)}, got {name!r}.")
    return NAMES.index(name)
