"""Draw docs/images/shapes.png, the benchmark's 100 shapes: `python -m tools.draw_shapes`."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes import CLASSES, benchmark_shapes

CELL, MARGIN, COLUMNS = 128, 130, 9


def main() -> None:
    """Draw one row a class, three-quarter views in varied paint and places."""
    sheet = Image.new("RGB", (MARGIN + COLUMNS * CELL, len(CLASSES) * CELL), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(18)
    rng = np.random.default_rng(3)
    for row, name in enumerate(CLASSES):
        draw.text((8, (row + 0.4) * CELL), name, fill=(30, 40, 50), font=font)
        for column, shape in enumerate(benchmark_shapes(name)):
            scene = Scene(
                shape=shape,
                colour=tuple(rng.uniform(0.1, 0.95, 3)),
                camera_distance=8.4,
                camera_azimuth_deg=rng.choice([-1, 1]) * rng.uniform(30, 65),
                camera_pitch_deg=rng.uniform(12, 24),
                light_azimuth_deg=rng.uniform(-80, 80),
                light_pitch_deg=rng.uniform(30, 60),
                backdrop=random_backdrop(rng),
            )
            picture = Image.fromarray(default_renderer().render(scene, CELL).image)
            sheet.paste(picture, (MARGIN + column * CELL, row * CELL))
    sheet.save(Path(__file__).parents[1] / "docs" / "images" / "shapes.png", optimize=True)


if __name__ == "__main__":
    main()
