"""Warped and noisy digits as shots: from the unchanged image to the attacked one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PIL import Image

from sada_gym.clips.shots import MORPH_FPS, Clip, Shot, ShotEnding, describe_world, path_to
from sada_gym.envs.digits.behaviour import with_article
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from sada_gym.envs.digits.base import ClassifierApplication

MANY = 30
"""More parameters than this are not named one by one."""


def clip(application: ClassifierApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the classifier's answer changes on the way from mu = 0."""
    path = path_to(mu, seconds)
    infos = application.evaluate(path, [seed] * len(path)).infos
    pictures = [Image.fromarray(application.render(row, seed)) for row in path]
    notes = [
        f"a {info['label']}, seen as {with_article(info['predicted'])}  ·  Q = {info['score']:.2f}"
        for info in infos
    ]
    label, predicted = infos[-1]["label"], infos[-1]["predicted"]
    right, wrong = (
        f"sees that it is {with_article(label)}",
        f"takes the {label} for {with_article(predicted)}",
    )
    ending = ShotEnding(right if predicted == label else wrong, infos[-1]["fooled"])
    many = len(application.parameters) > MANY
    world = "noise on every pixel" if many else describe_world(application, mu)
    return Clip([Shot(pictures, MORPH_FPS, notes, world, ending)], infos[-1]["score"])
