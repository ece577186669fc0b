"""Draw the picture of docs/environments/quadrotor.md: `python -m tools.draw_quadrotor`."""

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym import make_application
from sada_gym.envs.quadrotor.frame import summary
from sada_gym.envs.quadrotor.start import PARAMETERS
from tools.side_by_side import HEAD

IMAGES = Path(__file__).parents[1] / "docs" / "images"
TRACK, SEED = "SADA-Quadrotor-X500-v0", 1
SHAKING = {"torque_to_inertia": 650.0, "delay_s": 0.01, "speed_m_s": 2.0}
"""An agile X500 whose observations are 10 ms old."""


def mu_of(**changed: float) -> np.ndarray:
    """The mu in the middle of all ranges but for some values."""
    middle = PARAMETERS.describe(np.zeros(len(PARAMETERS)))
    return PARAMETERS.normalised(list((middle | changed).values()))


def main() -> None:
    """Draw a flight that follows beside one that does not."""
    application = make_application(TRACK)
    worlds = mu_of(), mu_of(**SHAKING)
    frames = [summary(application.rollouts(mu, SEED))[HEAD:] for mu in worlds]  # captions say it
    Image.fromarray(np.hstack(frames)).save(IMAGES / "quadrotor.png", optimize=True)


if __name__ == "__main__":
    main()
