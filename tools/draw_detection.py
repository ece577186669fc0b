"""Draw docs/images/detection-parameters.png: `python -m tools.draw_detection`.

One car along each parameter, the other parameters as in a photograph of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import default_renderer

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SEED = 10
USUAL = (9.0, 40.0, 14.0, 40.0, 50.0, 0.75, 0.12, 0.1)
"""Physical values: a red car from three quarters in front, the sun behind the camera."""
ROWS = {
    "camera\ndistance": [{0: d} for d in (8.0, 9.6, 11.2, 12.9, 14.5)],
    "camera\nazimuth": [{1: a} for a in (-180.0, -90.0, 0.0, 90.0, 135.0)],
    "camera\npitch": [{2: p} for p in (0.0, 13.0, 26.0, 39.0, 51.6)],
    "light\nazimuth": [{3: a} for a in (0.0, 60.0, 120.0, 180.0, -90.0)],
    "light\npitch": [{4: p} for p in (3.0, 15.0, 40.0, 65.0, 90.0)],
    "colour": [
        dict(zip((5, 6, 7), rgb, strict=True))
        for rgb in ((1, 1, 1), (0, 0, 0), (0.1, 0.2, 0.8), (0.2, 0.6, 0.2), (0.9, 0.8, 0.1))
    ],
}
UNITS = ("", "°", "°", "°", "°")
COLOURS = ("white", "black", "blue", "green", "yellow")
CELL, GAP, LABEL, MARGIN = 168, 8, 26, 104
INK, RED, FONT = (31, 41, 51), (185, 28, 28), ImageFont.load_default(18)


def main() -> None:
    """Draw a row for each parameter; below each picture the value and Q, red where it fools."""
    application = DetectionApplication("car")
    size = (MARGIN + 5 * (CELL + GAP) - GAP, len(ROWS) * (CELL + LABEL + GAP))
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for i, (name, changes) in enumerate(ROWS.items()):
        top = i * (CELL + LABEL + GAP)
        draw.text((2, top + CELL // 2 - 20), name, fill=INK, font=FONT)
        for j, change in enumerate(changes):
            values = np.array(USUAL)
            values[list(change)] = list(change.values())
            mu = application.parameters.normalised(values)
            outcome = application.evaluate(mu[None], [SEED])
            picture = default_renderer().render(application.scene(mu, SEED), CELL).image
            left = MARGIN + j * (CELL + GAP)
            sheet.paste(Image.fromarray(picture), (left, top))
            (index, value), *others = change.items()
            shown = COLOURS[j] if others else f"{value:g}{UNITS[index]}"
            colour = RED if outcome.fooled[0] else INK
            text = f"{shown}: Q {outcome.score[0]:.2f}"
            draw.text((left + 2, top + CELL + 2), text, fill=colour, font=FONT)
    sheet.save(IMAGES / "detection-parameters.png", optimize=True)


if __name__ == "__main__":
    main()
