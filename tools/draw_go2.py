"""Draw the picture of docs/environments/go2.md: `python -m tools.draw_go2`."""

from pathlib import Path

import numpy as np

from sada_gym import make_application
from sada_gym.envs.go2.application import ORDINARY
from sada_gym.envs.go2.frame import summary
from sada_gym.envs.go2.start import PARAMETERS
from tools.side_by_side import differing, save

IMAGES = Path(__file__).parents[1] / "docs" / "images"
TRACK, SEED = "SADA-Go2-Walk-v0", 3
"""The first seed of all with which the slow motors alone make it fall."""
LOADED = {
    **{"step_height_m": 0.06, "payload_kg": 5.0, "push_m_s": 1.5, "push_direction_deg": 90.0},
    "slope_deg": 5.0,
}
SLOW = {**LOADED, "motor_lag_s": 0.02}
"""The same with slower motors."""


def mu_of(**changed: float) -> np.ndarray:
    """The mu of the ordinary world but for some values."""
    return PARAMETERS.normalised([{**ORDINARY, **changed}[name] for name in PARAMETERS.names])


def main() -> None:
    """Draw a walk that holds beside one that does not."""
    application = make_application(TRACK)
    worlds = mu_of(**LOADED), mu_of(**SLOW)
    frames = [summary(application.rollouts(mu, SEED)) for mu in worlds]
    save(frames, differing(PARAMETERS, *worlds), IMAGES / "go2.png")


if __name__ == "__main__":
    main()
