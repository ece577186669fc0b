"""Plays a world again as a clip: the ends of its episodes, or the way to a single image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from sada_gym.analyses.replay.captions import MAX_HEIGHT, WIDTH
from sada_gym.analyses.replay.chart import score_chart
from sada_gym.analyses.replay.shots import (
    MORPH_FPS,
    Clip,
    Shot,
    describe_world,
    pace,
    path_to,
    scored_ending,
    share_time,
)
from sada_gym.application import Application
from sada_gym.errors import UserError
from sada_gym.evaluations import fools
from sada_gym.foundations.drawing import beside, resized_into
from sada_gym.foundations.files import shown
from sada_gym.foundations.frames import Frame, Take, as_frame
from sada_gym.parameters import Mu

LEAST_CHART = 210
"""The width that the chart beside a single image has at least."""


def make_clip(application: Application, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the episodes that failed ended, or the way from mu = 0 to a single image.

    Raises:
        UserError: If `replay` or `render` of the application does not return what it should.
    """
    if has_takes(application):
        takes, score = application.takes(mu, seed)  # type: ignore[attr-defined]
    else:
        takes, score = _replayed(application, mu, seed)
    if takes[0].count == len(takes) == 1:
        return Clip([_way_to(application, mu, seed, seconds, takes[0])], score)
    failures = [i for i, take in enumerate(takes) if take.failed]
    chosen, each_s = share_time(failures, seconds)
    world, shots = describe_world(application, mu), []
    for i in chosen:
        kept, fps, remark = pace(takes[i].count, application.render_fps, each_s)
        frames, notes = zip(*map(takes[i].draw, kept), strict=True)
        shots.append(
            Shot(
                [Image.fromarray(frame) for frame in frames],
                fps,
                [f"{note}{remark}" for note in notes],
                world,
                takes[i].ending,
                takes[i].failed,
            )
        )
    return Clip(shots, score)


def has_takes(application: Application) -> bool:
    """Say whether it tells its episodes apart; a `replay` that a user overrides goes first."""
    kinds = (vars(kind) for kind in type(application).__mro__)
    return "takes" in next(kind for kind in kinds if "takes" in kind or "replay" in kind)


def _replayed(application: Application, mu: Mu, seed: int) -> tuple[Sequence[Take], float]:
    name, fps = type(application).__name__, application.render_fps
    if not isinstance(fps, int | float | np.number) or not 0 < fps < np.inf:
        raise UserError(
            f"Expected `render_fps` of {name} above 0, got {fps!r}. It is the "
            "number of frames that `replay` returns for a second."
        )
    returned = application.replay(mu, seed)
    try:
        frames, score = returned
        frames, score = list(frames), float(score)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"Expected a list of frames and a score from {name}.replay, got "
            f"{shown(repr(returned))}."
        ) from error
    if not frames:
        raise UserError(f"Expected frames from {name}.replay, got none. Return at least one.")

    def draw(i: int) -> tuple[Frame, str]:
        return as_frame(frames[i], f"{name}.replay"), f"{i / fps:.1f} s"

    fooled = fools(score, application.fooling_threshold)
    return [Take(len(frames), draw, _ending(application, mu, seed), fooled)], score


def _ending(application: Application, mu: Mu, seed: int) -> str:
    if application.tells_behaviour:
        return shown(application.behaviours(mu[None], [seed])[0].text)
    (info,) = application.evaluate(mu[None], [seed]).infos
    return scored_ending(info["score"], application.fooling_threshold, info.get("ending"))


def _way_to(application: Application, mu: Mu, seed: int, seconds: float, take: Take) -> Shot:
    path = path_to(mu, seconds)
    seeds, source = [seed] * len(path), f"{type(application).__name__}.render"
    scores = application.evaluate(path, seeds).score
    pictures = []
    for i, drawn in enumerate(application.film_batch(path, seeds)):
        picture = Image.fromarray(as_frame(drawn, source))
        left = resized_into(picture, WIDTH - LEAST_CHART, MAX_HEIGHT)
        size = WIDTH - left.width, left.height
        chart = score_chart(scores[: i + 1], len(path), application.fooling_threshold, size)
        pictures.append(beside(left, chart))
    notes = [f"Q = {score:.2f}" for score in scores]
    world = describe_world(application, mu)
    return Shot(pictures, MORPH_FPS, notes, world, take.ending, take.failed)
