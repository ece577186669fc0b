"""Draw docs/images/driving-*.png: `python -m tools.draw_driving`.

The weathers, the ends of the camera's two axes, and two worlds: one where all drives arrive, one
where none does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.camera.pinhole import Lens, Mount, camera
from sada_gym.envs.driving.episodes import PICTURE_COLUMNS, PICTURE_ROWS
from sada_gym.envs.driving.frame import summary
from sada_gym.envs.driving.world.route import LAYOUT, benchmark_routes
from sada_gym.envs.driving.world.weather import NAMES

IMAGES = Path(__file__).parents[1] / "docs" / "images"
LENS = Lens(198, 450)
BAR = 24
TITLE, FOOT = 68, 34
"""Pixels: the heights of a summary's texts, which captions say."""
ROUTE = benchmark_routes("navigation")[0]
POINT = 62
"""Of the route: a street, with a junction ahead."""


def view(mount: Mount, weather: int, lens: Lens = LENS) -> Image.Image:
    """What a camera sees at one place."""
    pose = np.array([[*ROUTE.points[POINT], ROUTE.heading[POINT], mount.height_m]])
    rays, key = lens.rays(mount.pitch_deg)[None], np.array([7], np.uint64)
    (frame,) = camera(LAYOUT).draw(
        lens, rays, np.zeros(1, np.int64), pose, np.array([weather]), key
    )
    return Image.fromarray(frame)


def sheet(pictures: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Pictures in rows, each with its title below."""
    width, height = pictures[0][1].size
    rows = -(-len(pictures) // columns)
    whole = Image.new("RGB", (columns * width, rows * (height + BAR)), "white")
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(15)
    for i, (title, picture) in enumerate(pictures):
        left, top = i % columns * width, i // columns * (height + BAR)
        whole.paste(picture, (left, top))
        draw.text((left + 8, top + height + 3), title, fill=(31, 41, 51), font=font)
    return whole


def weathers() -> Image.Image:
    """The same place in six weathers."""
    return sheet([(name, view(Mount(), i)) for i, name in enumerate(NAMES)], 2)


def mounts() -> Image.Image:
    """The corners of the camera's range, the default, and what the driver sees of it."""
    shown = [
        (f"{height:.1f} m, {pitch:.0f}°", view(Mount(height, pitch), 0))
        for height, pitch in ((1.0, -20), (1.0, -10), (2.0, -20), (2.0, -10), (1.4, -15))
    ]
    small = view(Mount(), 0, Lens(PICTURE_ROWS, PICTURE_COLUMNS))
    seen = small.resize((LENS.columns, LENS.rows), Image.Resampling.NEAREST)
    title = f"the default, as the driver sees it: {PICTURE_ROWS} by {PICTURE_COLUMNS} pixels"
    return sheet([*shown, (title, seen)], 2)


def drives() -> Image.Image:
    """A world in which all five drives arrive, and one in which none does."""
    application = DrivingApplication("one_curve")
    good = summary(application.rollouts([-0.2, 0.0, -0.9], 7))
    bad = summary(application.rollouts([0.9, 0.8, 0.6], 3))
    both = np.hstack([good, np.full((len(good), 12, 3), 255, np.uint8), bad])
    return Image.fromarray(both[TITLE:-FOOT])


def main() -> None:
    """Draw them all."""
    for name, picture in (("weathers", weathers()), ("mounts", mounts()), ("drives", drives())):
        picture.save(IMAGES / f"driving-{name}.png", optimize=True)


if __name__ == "__main__":
    main()
