"""Plays a world again as a clip: in the application's own way, or in the way that suits any."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from PIL import Image

from sada_gym.application import Application
from sada_gym.cards import cards
from sada_gym.clips.shots import (
    MORPH_FPS,
    Clip,
    Shot,
    describe_world,
    pace,
    path_to,
    scored_ending,
)
from sada_gym.errors import UserError
from sada_gym.files import shown
from sada_gym.frames import Frame, as_frame
from sada_gym.lazy import load
from sada_gym.parameters import Mu

ClipFunction = Callable[[Application, Mu, int, float], Clip]
"""Plays the world of mu, (d,), and a seed again, and cuts it to about so many seconds."""

_WITHOUT_CARD = {
    "sada_gym.envs.wrapped.application:GymnasiumApplication": "sada_gym.envs.wrapped.clip:clip"
}


def find_clip(application: Application) -> ClipFunction:
    """Find what makes the clips of an application.

    The card of an application names its function. A user's application, and one that overrides
    `replay`, gets `replayed_clip`.
    """
    functions = _WITHOUT_CARD | {card.application: card.clip for card in cards() if card.clip}
    for kind in type(application).__mro__:
        if name := functions.get(f"{kind.__module__}:{kind.__qualname__}"):
            function: ClipFunction = load(name)
            return function
        if "replay" in vars(kind):
            break
    return replayed_clip


def replayed_clip(application: Application, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show the end of the episode that `replay` returns, or the way from mu = 0 to a single image.

    Raises:
        UserError: If `replay` or `render` of the application does not return what it should.
    """
    (info,) = application.evaluate(mu[None], [seed]).infos
    frames, score = _replay(application, mu, seed)
    ending = scored_ending(score, application.fooling_threshold, info.get("ending"))
    name = type(application).__name__
    if len(frames) == 1:
        path = path_to(mu, seconds)
        scores = application.evaluate(path, [seed] * len(path)).score
        frames = [as_frame(application.render(row, seed), f"{name}.render") for row in path]
        notes, fps = [f"Q = {score:.2f}" for score in scores], float(MORPH_FPS)
    else:
        kept, fps, remark = pace(len(frames), application.render_fps, seconds)
        frames = [as_frame(frames[i], f"{name}.replay") for i in kept]
        notes = [f"{i / application.render_fps:.1f} s{remark}" for i in kept]
    pictures = [Image.fromarray(frame) for frame in frames]
    return Clip([Shot(pictures, fps, notes, describe_world(application, mu), ending)], score)


def _replay(application: Application, mu: Mu, seed: int) -> tuple[Sequence[Frame], float]:
    name = type(application).__name__
    fps = application.render_fps
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
    return frames, score
