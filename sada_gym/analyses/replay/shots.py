"""What a film is made of: shots, each a part of an episode with the words below it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from sada_gym.application import Application
from sada_gym.evaluations import fools
from sada_gym.foundations.files import shown
from sada_gym.parameters import Mu

MORPH_STEPS, MORPH_FPS = 32, 8
"""A world of one image is reached from the nominal one in so many pictures."""
MIN_SHARE_S = 4.0
"""Several failures share a sample's time only as long as each gets this much."""
MAX_FPS = 20
SHORTEST_S = 2.0
"""A shorter episode is shown in slow motion."""
MIN_FPS = 1.0
"""An episode of fewer frames a second is shown in time lapse."""
MANY = 30
"""More parameters than this are not named one by one."""


@dataclass(frozen=True)
class Shot:
    """A part of an episode, or of the way to a world: pictures of one size, so many a second.

    A line of `notes` stands below each; `world` says in a line what the adversary chose, and
    `ending` in a few words how it ends, such as `hit the frame of gate 4`.
    """

    pictures: Sequence[Image.Image]
    fps: float
    notes: Sequence[str]
    world: str
    ending: str
    failed: bool


@dataclass(frozen=True)
class Clip:
    """A sample, played again, and its Q."""

    shots: Sequence[Shot]
    score: float


def path_to(mu: Mu, seconds: float) -> Mu:
    """Return the way from mu = 0 to mu, (n, d), slow at both ends; the last row is mu itself."""
    count = max(2, min(MORPH_STEPS, round(seconds * MORPH_FPS)))
    share = np.linspace(0.0, 1.0, count, dtype=np.float32)[:, None]
    path = (share * share * (3.0 - 2.0 * share) * mu).astype(np.float32)
    path[-1] = mu
    return path


def scored_ending(score: float, threshold: float, reason: object = None) -> str:
    """Return an ending in the application's own words, else by the score."""
    fooled = fools(score, threshold)
    text = shown(reason) if isinstance(reason, str) else None
    return text or f"Q = {score:.2f}: {'' if fooled else 'not '}fooled"


def pace(count: int, fps: float, seconds: float) -> tuple[range, float, str]:
    """Choose those of an episode's `count` frames that fill the last seconds, and their pace.

    Returns their indices, the last one included; frames a second; and a remark where the episode is
    shown in slow motion or time lapse.
    """
    lapse = "  ·  time lapse" if fps < MIN_FPS else ""
    fps = max(fps, MIN_FPS)
    stride = max(1, math.ceil(fps / MAX_FPS))
    if count < fps * SHORTEST_S and not lapse:
        return range(count), min(fps / stride, count / SHORTEST_S), "  ·  slow motion"
    kept = max(2, round(seconds * fps / stride))
    return range(count - 1, -1, -stride)[:kept][::-1], fps / stride, lapse


def share_time(failures: Sequence[int], seconds: float) -> tuple[Sequence[int], float]:
    """Choose the failures to show, and the seconds that each gets.

    Where no episode failed, the first one is shown.
    """
    chosen = (list(failures) or [0])[: max(1, int(seconds // MIN_SHARE_S))]
    return chosen, seconds / len(chosen)


def describe_world(application: Application, mu: Mu, count: int = 3) -> str:
    """Name the parameters that are farthest from the middle of their ranges, with their values."""
    if len(mu) > MANY:
        return f"{len(mu)} parameters"
    parameters = application.parameters.parameters
    values = application.parameters.physical(mu).tolist()
    farthest = sorted(range(len(mu)), key=lambda i: -abs(float(mu[i])))[:count]
    return ", ".join(parameters[i].text(values[i]) for i in sorted(farthest))
