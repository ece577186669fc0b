"""Draw docs/images/detection-coco.png: `python -m tools.draw_detection_coco`.

Above, a model as people photograph it; below, the same model and place in the uniform world, of 32,
in which the detector is most sure of another class, or least sure of the right one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.evaluation.problems import make_application
from studies.coco_classes import nominal_mu

OUT = Path(__file__).parents[1] / "docs" / "images" / "detection-coco.png"
TRACKS = ("Car", "Motorbike", "Bicycle", "Truck")
SEEDS = {"Car": 3, "Motorbike": 4, "Bicycle": 5, "Truck": 1}
WORLDS, SIDE, GAP = 32, 300, 8


def column(track: str) -> list[Image.Image]:
    """Draw a track's two frames."""
    application = make_application(f"SADA-DetectionCoco-{track}-v0")
    assert isinstance(application, DetectionApplication)
    rng, seed = np.random.default_rng(0), SEEDS[track]
    usual = nominal_mu(application, 1, rng)
    mu = rng.uniform(-1.0, 1.0, (WORLDS, len(application.parameters)))
    infos = application.evaluate(mu, [seed] * WORLDS).infos
    wrong = [
        max((d["score"] for d in info["detections"] if d["label"] != application.label), default=0)
        - info["score"]
        for info in infos
    ]
    chosen = np.concatenate([usual, mu[[int(np.argmax(wrong))]]])
    frames = application.render_batch(chosen, [seed, seed])
    return [Image.fromarray(frame).resize((SIDE, SIDE)) for frame in frames]


def main() -> None:
    """Draw all columns."""
    step = SIDE + GAP
    whole = Image.new("RGB", (step * len(TRACKS) - GAP, 2 * step - GAP), (255, 255, 255))
    for k, track in enumerate(TRACKS):
        for row, frame in enumerate(column(track)):
            whole.paste(frame, (k * step, row * step))
    whole.quantize(255).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
