"""Draw the pictures of driving in CARLA, in the tests' town: `python -m tools.draw_carla`.

It needs the package carla and no server.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt

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
    """Draw the town for its page and for the gallery."""
    fake_carla.start()
    for name, size in {"carla": (10, 4.4), "gallery-carla": (4.8, 3.0)}.items():
        figure = plt.figure(figsize=size, layout="constrained")
        town(figure.subplots())
        figure.savefig(IMAGES / f"{name}.png", dpi=100)


if __name__ == "__main__":
    main()
