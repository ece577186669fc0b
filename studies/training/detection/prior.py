"""The photographer's prior: from where people photograph an object, and which colours it has.

A detector trained on people's photographs knows objects from where people stand. The prior puts
this into numbers. They are common sense, written down before any fooling rate was measured:

- Distance: the object fills the frame. The distance is 8 + 6.5 Beta(1.3, 2.5) scene
  units, on average 10.2.
- Pitch: the camera is at eye level. Its pitch is N(9, 7) degrees within [0, 30].
- Light: the sun stands behind the photographer, and high. Its azimuth differs from the camera's
  by N(0, 55) degrees; its pitch is N(45, 15) degrees within [12, 80].
- Aim: the object is nearly in the middle. Its offset is N(0, 0.1) of half the frame, in each axis.

N(m, s) is a normal distribution with mean m and standard deviation s; values outside the range in
brackets are drawn again.
"""

from __future__ import annotations

import colorsys

import numpy as np

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes.model import Shape

_RANGES = {p.name: (p.low, p.high) for p in DetectionApplication.parameters.parameters}

# weight, hue, spread of hue, saturation from, to, value from, to
PAINTS = (
    (0.22, 0.0, 0.5, 0.0, 0.06, 0.82, 1.0),  # white
    (0.2, 0.0, 0.5, 0.0, 0.12, 0.05, 0.25),  # black
    (0.2, 0.6, 0.1, 0.0, 0.12, 0.35, 0.75),  # grey, silver
    (0.14, 0.6, 0.03, 0.4, 0.9, 0.3, 0.8),  # blue
    (0.12, 0.99, 0.02, 0.6, 0.95, 0.4, 0.85),  # red
    (0.06, 0.07, 0.02, 0.35, 0.7, 0.25, 0.6),  # brown
    (0.03, 0.36, 0.04, 0.3, 0.7, 0.25, 0.55),  # green
    (0.03, 0.14, 0.02, 0.6, 0.95, 0.75, 0.95),  # yellow
)

# weight, mean and spread of the azimuth's magnitude in degrees
STANDPOINTS = ((0.5, 45.0, 17.0), (0.3, 90.0, 12.0), (0.1, 0.0, 12.0), (0.1, 135.0, 14.0))


def photograph(shape: Shape | None, rng: np.random.Generator) -> Scene:
    """Draw a scene as a photographer would find and take it."""
    spot = STANDPOINTS[rng.choice(len(STANDPOINTS), p=[s[0] for s in STANDPOINTS])]
    return Scene(
        shape=shape,
        colour=_paint(rng),
        camera_distance=8.0 + 6.5 * rng.beta(1.3, 2.5),
        camera_azimuth_deg=rng.choice([-1, 1]) * rng.normal(spot[1], spot[2]),
        camera_pitch_deg=_truncated(rng, 9.0, 7.0, 0.0, 30.0),
        light_azimuth_deg=rng.normal(0.0, 55.0),
        light_pitch_deg=_truncated(rng, 45.0, 15.0, 12.0, 80.0),
        backdrop=random_backdrop(rng),
        aim=_aim(rng),
    )


def survey(shape: Shape | None, rng: np.random.Generator) -> Scene:
    """Draw a scene from everywhere: uniform over the benchmark's parameters, nearly centred."""

    def draw(name: str) -> float:
        return rng.uniform(*_RANGES[name])

    return Scene(
        shape=shape,
        colour=(draw("colour_red"), draw("colour_green"), draw("colour_blue")),
        camera_distance=draw("camera_distance"),
        camera_azimuth_deg=draw("camera_azimuth_deg"),
        camera_pitch_deg=draw("camera_pitch_deg"),
        light_azimuth_deg=draw("light_azimuth_deg"),
        light_pitch_deg=draw("light_pitch_deg"),
        backdrop=random_backdrop(rng),
        aim=_aim(rng),
    )


def _aim(rng: np.random.Generator) -> tuple[float, float]:
    return rng.normal(0.0, 0.1), rng.normal(0.0, 0.1)


def _truncated(
    rng: np.random.Generator, mean: float, spread: float, low: float, high: float
) -> float:
    while not low <= (value := rng.normal(mean, spread)) <= high:
        pass
    return value


def _paint(rng: np.random.Generator) -> tuple[float, float, float]:
    _, hue, spread, *ranges = PAINTS[rng.choice(len(PAINTS), p=[p[0] for p in PAINTS])]
    saturation, value = rng.uniform(ranges[0], ranges[1]), rng.uniform(ranges[2], ranges[3])
    return colorsys.hsv_to_rgb((hue + rng.uniform(-spread, spread)) % 1.0, saturation, value)
