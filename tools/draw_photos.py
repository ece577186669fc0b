"""Draw docs/images/photos.png and own-images.png: `python -m tools.draw_photos`.

The first shows haze with a visibility of 52 m and nothing else, on the first seed at which half of
the people are missed or more. The second shows, of 60 uniform worlds that fool the detector, the
one in which a person sees most, by the photograph's contrast.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.evaluation.problems import make_application

HAZE_M = 52.0
IMAGES = Path(__file__).parents[1] / "docs" / "images"


def main() -> None:
    """Draw both."""
    application = make_application("SADA-Photos-Street-v0")
    space, seeds = application.parameters, list(range(60))
    usual = application.nominal
    assert usual is not None
    hazy = space.normalised([*(space.describe(usual) | {"visibility_m": HAZE_M}).values()])
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(space))).astype(np.float32)
    fooled = np.flatnonzero(application.evaluate(mu, seeds).fooled)
    clearest = max(fooled, key=lambda i: application.observation(mu[i], seeds[i]).std())
    first = int(application.evaluate(np.tile(hazy, (60, 1)), seeds).fooled.argmax())
    drawn = {"photos": (hazy, first), "own-images": (mu[clearest], seeds[clearest])}
    for name, world in drawn.items():
        Image.fromarray(application.render(*world)).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
