"""Draw docs/images/delay.gif, an agent that balances a pole, and the same agent that sees late.

python -m tools.draw_delay
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import ObservationDelay
from sada_gym.foundations.drawing import font
from sada_gym.foundations.frames import INK, Frame

IMAGES = Path(__file__).parents[1] / "docs" / "images"
OUT = IMAGES / "delay.gif"
DELAY, SEED, EVERY, HOLD = 3, 0, 2, 30
TOP, BOTTOM, SIZE, BAR = 120, 340, (360, 132), 26


def main() -> None:
    """Replay one world without the delay and one with it, side by side, until that episode ends."""
    application = GymnasiumApplication(
        "CartPole-v1",
        agent=lambda state: int(state[2] + state[3] > 0),
        parameters={"delay": ObservationDelay(0, DELAY)},
        score=("length", 500),
        fooling_threshold=0.5,
    )
    good, late = (list(application.replay([mu], SEED)[0]) for mu in (-1.0, 1.0))
    said = "observations on time", f"{DELAY} steps late"
    write(good, late, said, "it leaves the track", OUT)


def write(
    passing: Sequence[Frame], failing: Sequence[Frame], said: tuple[str, str], end: str, out: Path
) -> None:
    """Write two episodes of CartPole side by side as a GIF that ends with the failing one."""
    steps = [*range(0, len(failing) - 1, EVERY), *[len(failing) - 1] * HOLD]
    pictures = []
    for step in steps:
        picture = Image.new("RGB", (2 * SIZE[0] + 4, SIZE[1] + BAR), "white")
        fallen = step == len(failing) - 1
        texts = said[0], said[1] + (f": {end}" if fallen else "")
        for i, (frames, text) in enumerate(zip((passing, failing), texts, strict=True)):
            shown = Image.fromarray(np.asarray(frames[step])[TOP:BOTTOM])
            left = i * (SIZE[0] + 4)
            picture.paste(shown.resize(SIZE, Image.Resampling.LANCZOS), (left, BAR))
            ImageDraw.Draw(picture).text((left + 6, 5), text, fill=INK, font=font(14))
        pictures.append(picture.quantize(16))
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=40, loop=0)
    print(f"{len(failing) - 1} steps, {out.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
