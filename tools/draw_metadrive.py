"""Draw the picture of docs/environments/metadrive.md: `python -m tools.draw_metadrive`."""

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym import make_application
from sada_gym.envs.metadrive.frame import summary

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SEED, FAILED = 1, 13
LINE, HEAD = 30, 180
"""Pixels: a line of a summary's text, and all of its text."""


def uniform(seed: int) -> np.ndarray:
    """A uniform mu, (15,)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, 15).astype(np.float32)


def main() -> None:
    """Draw a nominal drive beside one that fails."""
    application = make_application("SADA-DrivingMetaDrive-v0")
    worlds = ((application.nominal, SEED), (uniform(FAILED), FAILED))
    summaries = [summary(application.rollouts(mu, seed)) for mu, seed in worlds]
    frames = [np.vstack([one[: LINE + 4], one[HEAD:]]) for one in summaries]
    Image.fromarray(np.hstack(frames)).save(IMAGES / "metadrive.png", optimize=True)


if __name__ == "__main__":
    main()
