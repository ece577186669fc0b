"""Draw the pictures of the pages on digits and the pixel attack: `python -m tools.draw_digits`.

They go to docs/images: each parameter's range, failures of each digit, and pixel attacks.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch.nn import functional

from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.digits.base import INK, RIGHT, WRONG, enlarged
from sada_gym.envs.pixel import PixelApplication

IMAGES = Path(__file__).parents[1] / "docs" / "images"
CELL, GAP, LABEL, MARGIN = 104, 10, 22, 110
STEPS = (-1.0, -0.5, 0.0, 0.5, 1.0)
FAILURES = 6
FONT = ImageFont.load_default(15)
Cell = tuple[np.ndarray, str, tuple[int, int, int]]


def sheet(rows: list[tuple[str, list[Cell]]]) -> Image.Image:
    """Images in rows, each row with its name before it and each image with a caption below."""
    count = max(len(cells) for _, cells in rows)
    size = (MARGIN + count * (CELL + GAP), len(rows) * (CELL + LABEL + GAP))
    whole = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(whole)
    for i, (name, cells) in enumerate(rows):
        top = i * (CELL + LABEL + GAP)
        draw.text((4, top + CELL // 2 - 8), name, fill=INK, font=FONT)
        for j, (image, caption, colour) in enumerate(cells):
            left = MARGIN + j * (CELL + GAP)
            picture = Image.fromarray(enlarged(image))
            whole.paste(picture.resize((CELL, CELL), Image.Resampling.NEAREST), (left, top))
            draw.text((left + 2, top + CELL + 2), caption, fill=colour, font=FONT)
    return whole


def parameters() -> Image.Image:
    """One image along each parameter, the others neutral."""
    application = DigitsApplication(image=9)
    rows = []
    for i, parameter in enumerate(application.parameters.parameters):
        mu = np.zeros((len(STEPS), 6), np.float32)
        mu[:, i] = STEPS
        infos = application.evaluate(mu, [0] * len(mu)).infos
        cells = []
        for row, info in zip(mu, infos, strict=True):
            value = f"{info['parameters'][parameter.name]:.3g}, Q {info['score']:.2f}"
            colour = WRONG if info["fooled"] else INK
            cells.append((application.attacked_image(row, 0)[1], value, colour))
        rows.append((parameter.name, cells))
    return sheet(rows)


def failures(digits: Iterable[int] = range(10)) -> Image.Image:
    """The first uniform worlds of each digit that fool, not chosen further."""
    rows = []
    for digit in digits:
        application = DigitsApplication(digit)
        rng = np.random.default_rng(digit)
        mu = rng.uniform(-1, 1, (1_000, 6)).astype(np.float32)
        outcomes = application.evaluate(mu, range(1_000))
        cells = []
        for i in np.flatnonzero(outcomes.fooled)[:FAILURES]:
            said = f"seen as {outcomes.infos[i]['predicted']}"
            cells.append((application.attacked_image(mu[i], int(i))[1], said, WRONG))
        rows.append((f"digit {digit}", cells))
    return sheet(rows)


def misread() -> Image.Image:
    """The same of three digits, for the top of a page."""
    return failures((3, 7, 4))


def gradient_sign(application: PixelApplication) -> np.ndarray:
    """The mu (64,) along which the loss on the application's image rises."""
    clean = application.images.images[application.indices]
    image = torch.from_numpy(clean.copy())[:, None].requires_grad_(True)
    label = torch.from_numpy(application.images.labels[application.indices].copy())
    loss = functional.cross_entropy(application.agent(image), label)
    (gradient,) = torch.autograd.grad(loss, image)
    return gradient.sign().flatten().numpy()


def pixels() -> Image.Image:
    """An image, with random noise and with the gradient's sign, at two radii."""
    rows = []
    for radius in (0.15, 0.25):
        application = PixelApplication(image=3, radius=radius)
        random = np.sign(np.random.default_rng(0).uniform(-1, 1, 64))
        cells = []
        for name, mu in (
            ("unchanged", np.zeros(64)),
            ("random", random),
            ("gradient", gradient_sign(application)),
        ):
            (info,) = application.evaluate(mu[None], [0]).infos
            colour = WRONG if info["fooled"] else RIGHT
            said = f"{name}: {info['predicted']}"
            cells.append((application.attacked_image(mu, 0)[1], said, colour))
        rows.append((f"radius {radius:g}", cells))
    return sheet(rows)


def main() -> None:
    """Draw all."""
    for draw in (parameters, failures, misread, pixels):
        draw().save(IMAGES / f"digits-{draw.__name__}.png", optimize=True)


if __name__ == "__main__":
    main()
