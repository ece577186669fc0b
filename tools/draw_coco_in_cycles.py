"""Draw the COCO detector's failures in Cycles: `python -m tools.draw_coco_in_cycles`.

docs/images/detection-coco-cycles.png has the worst, a typical and a diverse failure of each class,
from the samples of the entry of `level-set`, which were learnt in the rasteriser. The choice is
that of `fooled.png`. docs/images/failure-coco.png shows the typical ones below the same models as
people photograph them. The boxes are what the detector says of these pictures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.analyses.plots.failure_choice import choose_failures
from sada_gym.board.results.entry import read_entry
from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.renderers.blender import Blender
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.frames import Frame
from studies.coco_classes import nominal_mu

ROOT = Path(__file__).parents[1]
ENTRY = ROOT / "leaderboard" / "entries" / "level-set"
OUT = ROOT / "docs" / "images"
CLASSES = ("Car", "Motorbike", "Bicycle", "Bus")
SIDE, SAMPLES, GAP = 300, 64, 8


def column(suffix: str, renderer: Blender) -> list[Frame]:
    """Draw a class's nominal view, and its worst, a typical and a diverse failure."""
    track = f"SADA-DetectionCoco-{suffix}-v0"
    application = make_application(track, renderer=renderer)
    assert isinstance(application, DetectionApplication)
    (result,) = read_entry(ENTRY).keeping(lambda of: of.track == track).results.values()
    samples = result.samples[0]
    chosen = choose_failures(
        application.parameters, samples, application.fooling_threshold, (1, 1, 1)
    )
    rows = [failure.sample for failure in chosen.shown]
    typical = chosen.typical[0].sample
    usual = nominal_mu(application, 1, np.random.default_rng(0))
    mu = np.concatenate([usual, samples.mu[rows]])
    seeds = [int(samples.seed[typical]), *samples.seed[rows].tolist()]
    return list(application.render_batch(mu, seeds))


def sheet(columns: list[list[Frame]], rows: tuple[int, ...], out: Path) -> None:
    """Write some rows of all columns as one picture."""
    step = SIDE + GAP
    whole = Image.new("RGB", (step * len(columns) - GAP, step * len(rows) - GAP), (255, 255, 255))
    for x, frames in enumerate(columns):
        for y, row in enumerate(rows):
            picture = Image.fromarray(frames[row]).resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            whole.paste(picture, (x * step, y * step))
    whole.quantize(255).save(out, optimize=True)


def main() -> None:
    """Draw both pictures."""
    renderer = Blender(samples=SAMPLES)
    columns = [column(suffix, renderer) for suffix in CLASSES]
    renderer.close()
    sheet(columns, (1, 2, 3), OUT / "detection-coco-cycles.png")
    sheet(columns, (0, 2), OUT / "failure-coco.png")


if __name__ == "__main__":
    main()
