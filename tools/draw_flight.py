"""Draw the picture of docs/environments/flight.md: `python -m tools.draw_flight`."""

from pathlib import Path

import numpy as np

from sada_gym import make_application
from sada_gym.envs.flight.frame import summary
from sada_gym.envs.flight.start import NOMINAL, PARAMETERS
from tools.side_by_side import differing, save

IMAGES = Path(__file__).parents[1] / "docs" / "images"
TRACK, SEED = "SADA-Flight-C310-v0", 1
SINKING = {"downdraught_ft_min": 1_000.0, "lost_lift": 0.3, "added_drag": 0.4, "payload": 1.0}
"""A full Cessna 310 with ice in a downdraught."""


def mu_of(**changed: float) -> np.ndarray:
    """The mu of the nominal world but for some values."""
    return PARAMETERS.normalised(list((PARAMETERS.describe(NOMINAL) | changed).values()))


def main() -> None:
    """Draw a flight that holds beside one that stalls."""
    application = make_application(TRACK)
    worlds = NOMINAL, mu_of(**SINKING)
    frames = [summary(application.rollouts(mu, SEED)) for mu in worlds]
    save(frames, differing(PARAMETERS, *worlds), IMAGES / "flight.png")


if __name__ == "__main__":
    main()
