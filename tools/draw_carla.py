"""Draw the pictures of driving in CARLA, in the tests' town: `python -m tools.draw_carla`.

It needs the package carla and no server.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sada_gym.envs.carla.application import CarlaDrivingApplication
from sada_gym.envs.carla.routes import find_routes

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
import fake_carla  # noqa: E402

IMAGES = ROOT / "docs" / "images"


def town(axes: plt.Axes) -> None:
    """Draw the lanes and the five routes of `navigation`."""
    points, _ = fake_carla.lane_points()
    axes.scatter(*points.T, s=1, color="0.8")
    for i, route in enumerate(find_routes(fake_carla.town(), "navigation")):
        shifted = route.points_m + 0.7 * (i - 2)
        axes.plot(*shifted.T, lw=1.8)
        axes.plot(*shifted[0], "o", color="0.2", ms=5)
        axes.plot(*shifted[-1], "s", color="0.2", ms=5)
    axes.set_aspect("equal")
    axes.invert_yaxis()  # y grows to the south in CARLA
    axes.set_axis_off()


def main() -> None:
    """Draw both pictures."""
    fake_carla.start()
    application = CarlaDrivingApplication("straight", agent=fake_carla.lane_driver, agent_id="lane")
    worlds = {
        "1.4 m, -15°, ClearNoon": (1.4, -15.0, 0.5),
        "2 m, -10°, ClearNoon": (2.0, -10.0, 0.5),
        "1.4 m, -15°, SoftRainSunset": (1.4, -15.0, 5.5),
    }
    figure = plt.figure(figsize=(10, 4.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.9, 1))
    town(above.subplots())
    for axes, (title, world) in zip(below.subplots(1, 3), worlds.items(), strict=True):
        axes.imshow(application.render(application.parameters.normalised(np.array(world)), 0))
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    figure.savefig(IMAGES / "carla.png", dpi=100)
    card = plt.figure(figsize=(4.8, 3.0), layout="constrained")
    town(card.subplots())
    card.savefig(IMAGES / "gallery-carla.png", dpi=100)


if __name__ == "__main__":
    main()
