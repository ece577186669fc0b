"""Draw docs/images/failures.png, README's first picture: `python -m tools.draw_failures`.

One failure of each application. Of the uniform worlds of a fixed seed, the detector's is the one
that it most surely takes for something else; the driver's and the pilot's have the lowest score.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym import Application, make_application

OUT = Path(__file__).parents[1] / "docs" / "images" / "failures.png"
WORLDS = 48
HEIGHT, GAP, FONT = 450, 20, 27
INK = (31, 41, 51)
Panel = tuple[Image.Image, str]


def uniform_worlds(application: Application) -> tuple[np.ndarray, list[int]]:
    """Uniform mu, (WORLDS, d), and their seeds."""
    rng = np.random.default_rng(2)
    return rng.uniform(-1.0, 1.0, (WORLDS, len(application.parameters))), list(range(WORLDS))


def detection() -> Panel:
    """A car that the detector takes for something else."""
    application = make_application("SADA-Detection-Car-v0")
    mu, seeds = uniform_worlds(application)
    infos = application.evaluate(mu, seeds).infos
    sure = [
        max((one["score"] for one in info["detections"]), default=0.0) if info["fooled"] else 0.0
        for info in infos
    ]
    worst = int(np.argmax(sure))
    names = {label: name for name, label in application.agent.labels.items()}
    taken_for = names[infos[worst]["detections"][0]["label"]]
    picture = Image.fromarray(application.render(mu[worst], seeds[worst]))
    return picture, f"Detection: a car,\ntaken for a {taken_for}"


def driving() -> Panel:
    """The driver about to leave its lane, above the map of its five routes."""
    application = make_application("SADA-Driving-OneCurve-v0")
    mu, seeds = uniform_worlds(application)
    outcomes = application.evaluate(mu, seeds)
    worst = int(outcomes.score.argmin())
    info = outcomes.infos[worst]
    failed = sum(ending != "arrived" for ending in info["endings"])
    frame = application.render(mu[worst], seeds[worst])
    picture = Image.fromarray(frame[68:-34])  # less the lines of text
    return picture, f"Driving: {failed} of 5 drives fail,\n{info['weather']}"


def racing() -> Panel:
    """The pilot on its way to the gate that it will miss."""
    application = make_application("SADA-UAV-4Anchors-v0")
    mu, seeds = uniform_worlds(application)
    worst = int(application.evaluate(mu, seeds).score.argmin())
    picture = Image.fromarray(application.render(mu[worst], seeds[worst])[:384, :512])
    return picture, "Racing: about to miss a gate,\non another track"


def strip(panels: list[Panel]) -> Image.Image:
    """Panels of one height side by side, each with its caption below."""
    font = ImageFont.load_default(FONT)
    pictures = [
        picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT))
        for picture, _ in panels
    ]
    width = sum(picture.width for picture in pictures) + GAP * (len(panels) - 1)
    whole = Image.new("RGB", (width, HEIGHT + 3 * FONT), "white")
    draw, left = ImageDraw.Draw(whole), 0
    for picture, (_, caption) in zip(pictures, panels, strict=True):
        whole.paste(picture, (left, 0))
        draw.text((left, HEIGHT + 10), caption, fill=INK, font=font)
        left += picture.width + GAP
    return whole


if __name__ == "__main__":
    strip([detection(), driving(), racing()]).save(OUT, optimize=True)
