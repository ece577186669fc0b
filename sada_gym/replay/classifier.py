"""Warped and noisy digits as shots: from the unchanged image to the attacked one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PIL import Image

from sada_gym.replay import shots
from sada_gym.replay.shots import MORPH_FPS, Shot, Take

if TYPE_CHECKING:
    from sada_gym.envs.digits.base import ClassifierApplication


def take(application: ClassifierApplication, mu: shots.Mu, seed: int, seconds: float) -> Take:
    """Show how the classifier's answer changes on the way from mu = 0."""
    way = shots.way_to(mu, seconds)
    outcomes = application.evaluate(way, [seed] * len(way))
    pictures = [Image.fromarray(application.render(row, seed)) for row in way]
    notes = [
        f"a {info['label']}, seen as {_a(info['predicted'])}  ·  Q = {info['score']:.2f}"
        for info in outcomes.infos
    ]
    last = outcomes.infos[-1]
    wrong = last["predicted"] != last["label"]
    said = f"takes the {last['label']} for {_a(last['predicted'])}"
    text = said if wrong else f"sees that it is {_a(last['label'])}"
    ending = shots.Ending(text, last["fooled"])
    many = len(application.parameters) > shots.MANY
    world = "noise on every pixel" if many else shots.world_words(application, mu)
    return Take([Shot(pictures, MORPH_FPS, notes, world, ending)], last["score"])


def _a(number: int) -> str:
    return f"an {number}" if number in (8, 11, 18) else f"a {number}"
