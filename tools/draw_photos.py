"""Draw docs/images/photos.png and own-images.png: `python -m tools.draw_photos`.

Of 60 uniform worlds they show the two in which a person sees most, by the photograph's contrast,
and the detector is fooled.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.evaluation.problems import make_application

IMAGES = Path(__file__).parents[1] / "docs" / "images"


def main() -> None:
    """Draw both."""
    application = make_application("SADA-Photos-Street-v0")
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1.0, 1.0, (60, len(application.parameters))).astype(np.float32)
    seeds = list(range(60))
    fooled = np.flatnonzero(application.evaluate(mu, seeds).fooled)
    seen = [application.observation(mu[world], seeds[world]).std() for world in fooled]
    for name, i in zip(("own-images", "photos"), np.argsort(seen)[::-1], strict=False):
        frame = application.render(mu[fooled[i]], seeds[fooled[i]])
        Image.fromarray(frame).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
