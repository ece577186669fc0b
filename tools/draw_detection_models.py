"""Draw docs/images/detection-{models,renderers}.png: `python -m tools.draw_detection_models`.

One view of a car in one place: the benchmark's shape, the box of the page's example as a CAD file,
a textured model, and this model in Blender. The second picture has the last two alone.
"""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.renderers.base import Renderer
from sada_gym.envs.detection.renderers.blender import Blender
from sada_gym.foundations.drawing import INK_RGB, font

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SEED, SIDE, GAP, LABEL = 10, 280, 8, 34
VIEW = (9.0, 40.0, 14.0, 40.0, 50.0, 0.75, 0.12, 0.1)
"""Physical values: red paint, from three quarters in front, the sun behind the camera."""
CORNERS = [(x, y, z) for x in (0, 4.2) for y in (0, 1.8) for z in (0, 1.5)]
SIDES = "1 2 4 3, 5 7 8 6, 1 5 6 2, 3 4 8 7, 1 3 7 5, 2 6 8 4"


def brick(folder: str) -> str:
    """Write a box as a set of CAD files, and return its folder."""
    car = Path(folder) / "car"
    car.mkdir()
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {side}" for side in SIDES.split(", ")]
    (car / "brick.obj").write_text("\n".join(lines) + "\n")
    (car.parent / "shapes.json").write_text(json.dumps({"up": "+z", "front": "+x"}))
    return folder


def view(shapes: str, renderer: Renderer) -> Image.Image:
    """Draw a car of a set of shapes in the benchmark's place, whatever the number of its shapes."""
    usual, application = DetectionApplication("car"), DetectionApplication("car", shapes=shapes)
    mu = application.parameters.normalised(np.array(VIEW))
    scene = replace(application.scene(mu, SEED), backdrop=usual.scene(mu, SEED).backdrop)
    return Image.fromarray(renderer.render(scene, SIDE).image)


def main() -> None:
    """Draw the four pictures in a row, each with its name below."""
    with TemporaryDirectory() as folder, closing(Blender(samples=64)) as blender:
        pictures = {
            "the benchmark's": view("benchmark", default_renderer()),
            "your CAD file": view(brick(folder), default_renderer()),
            "textured model": view("textured", default_renderer()),
            "the same in Blender": view("textured", blender),
        }
    size = ((SIDE + GAP) * len(pictures) - GAP, SIDE + LABEL)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for place, (name, picture) in enumerate(pictures.items()):
        left = place * (SIDE + GAP)
        sheet.paste(picture, (left, 0))
        draw.text((left + 2, SIDE + 6), name, fill=INK_RGB, font=font(20))
    sheet.save(IMAGES / "detection-models.png", optimize=True)
    two = sheet.crop((2 * (SIDE + GAP), 0, *size))
    two.save(IMAGES / "detection-renderers.png", optimize=True)


if __name__ == "__main__":
    main()
