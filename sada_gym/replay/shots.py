"""What a film is made of: shots, each a part of an episode with the words below it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.application import Application
from sada_gym.errors import UserError
from sada_gym.evaluations import fools
from sada_gym.files import shown
from sada_gym.frames import Frame, checked_frame
from sada_gym.lazy import load

MORPH_STEPS, MORPH_FPS = 32, 8
"""A world of one image is reached from the nominal one in so many pictures."""
LEAST_S = 4.0
"""Several failures share a sample's time only as long as each gets this much."""
MOST_FPS = 20
SHORTEST_S = 2.0
"""A shorter episode is shown in slow motion."""
MANY = 30
"""More parameters than this are not named one by one."""

Mu = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Ending:
    """How a shot ends.

    Attributes:
        text: The reason in a few words, such as `hit the frame of gate 4`.
        failed: Whether the agent failed.
    """

    text: str
    failed: bool


@dataclass(frozen=True)
class Shot:
    """A part of an episode, or of the way to a world.

    Attributes:
        pictures: Its pictures, all of one size.
        fps: Pictures a second.
        notes: A line below each picture.
        world: What the adversary chose, a line.
        ending: How it ends.
    """

    pictures: Sequence[Image.Image]
    fps: float
    notes: Sequence[str]
    world: str
    ending: Ending


@dataclass(frozen=True)
class Take:
    """A sample, played again.

    Attributes:
        shots: Its shots.
        score: Its Q.
    """

    shots: Sequence[Shot]
    score: float


Maker = Callable[[Application, Mu, int, float], Take]
"""Plays the world of mu, (d,), and a seed again, and cuts it to about so many seconds."""

_MAKERS = {
    "sada_gym.envs.driving.application:DrivingApplication": "sada_gym.replay.driving:take",
    "sada_gym.envs.uav.application:UAVApplication": "sada_gym.replay.racing:take",
    "sada_gym.envs.robot.application:RobotApplication": "sada_gym.replay.robot:take",
    "sada_gym.envs.detection.application:DetectionApplication": "sada_gym.replay.detection:take",
    "sada_gym.envs.digits.base:ClassifierApplication": "sada_gym.replay.classifier:take",
    "sada_gym.envs.wrapped.application:GymnasiumApplication": "sada_gym.replay.wrapped:take",
}
"""The applications whose episodes are told in their own way. All others get `any_take`."""


def maker_of(application: Application) -> Maker:
    """Find what makes the shots of an application; its own `replay` goes before our way."""
    for kind in type(application).__mro__:
        known = _MAKERS.get(f"{kind.__module__}:{kind.__qualname__}")
        if known is not None:
            maker: Maker = load(known)
            return maker
        if "replay" in vars(kind):
            break
    return any_take


def any_take(application: Application, mu: Mu, seed: int, seconds: float) -> Take:
    """Show what `replay` gives: an episode's end, or the way from mu = 0 to a single image."""
    (info,) = application.evaluate(mu[None], [seed]).infos
    frames, score = _replayed(application, mu, seed)
    ending = scored_ending(score, application.fooling_threshold, info.get("ending"))
    world, name = world_words(application, mu), type(application).__name__
    if len(frames) == 1:
        way = way_to(mu, seconds)
        scores = application.evaluate(way, [seed] * len(way)).score
        drawn = [checked_frame(application.render(row, seed), f"{name}.render") for row in way]
        notes, fps = [f"Q = {one:.2f}" for one in scores], float(MORPH_FPS)
    else:
        kept, fps, remark = paced(len(frames), application.render_fps, seconds)
        drawn = [checked_frame(frames[i], f"{name}.replay") for i in kept]
        notes = [f"{i / application.render_fps:.1f} s{remark}" for i in kept]
    pictures = [Image.fromarray(frame) for frame in drawn]
    return Take([Shot(pictures, fps, notes, world, ending)], score)


def _replayed(application: Application, mu: Mu, seed: int) -> tuple[Sequence[Frame], float]:
    """Let an application replay a world, and check that it gives frames and a score."""
    name = type(application).__name__
    if not application.render_fps > 0:
        raise UserError(
            f"Expected `render_fps` of {name} above 0, got {application.render_fps!r}. It is the "
            "number of frames that `replay` gives for a second."
        )
    given = application.replay(mu, seed)
    try:
        listed, score = given
        frames, q = list(listed), float(score)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"Expected a list of frames and a score from {name}.replay, got {shown(repr(given))}."
        ) from error
    if not frames:
        raise UserError(f"Expected frames from {name}.replay, got none. Return at least one.")
    return frames, q


def way_to(mu: Mu, seconds: float) -> Mu:
    """Give the way from mu = 0 to mu, (n, d), slow at both ends; the last row is mu itself."""
    count = max(2, min(MORPH_STEPS, round(seconds * MORPH_FPS)))
    share = np.linspace(0.0, 1.0, count, dtype=np.float32)[:, None]
    way = (share * share * (3.0 - 2.0 * share) * mu).astype(np.float32)
    way[-1] = mu
    return way


def scored_ending(score: float, threshold: float, reason: object = None) -> Ending:
    """End with what the application says, else with the score."""
    fooled = fools(score, threshold)
    said = shown(reason) if isinstance(reason, str) else None
    return Ending(said or f"Q = {score:.2f}: {'' if fooled else 'not '}fooled", fooled)


def paced(count: int, fps: float, seconds: float) -> tuple[range, float, str]:
    """Choose the frames of an episode's end, and their pace.

    Args:
        count: The episode's frames.
        fps: How many of them belong to a second.
        seconds: The time to fill.

    Returns:
        The frames' indices, the last one included; frames a second; and a remark where an episode
        is too short to be seen in its own time.
    """
    stride = max(1, math.ceil(fps / MOST_FPS))
    if count < fps * SHORTEST_S:
        return range(count), min(fps / stride, count / SHORTEST_S), "  ·  slow motion"
    most = max(2, round(seconds * fps / stride))
    return range(count - 1, -1, -stride)[:most][::-1], fps / stride, ""


def shared(failed: Sequence[int], seconds: float) -> tuple[Sequence[int], float]:
    """Choose the failures to show, and the seconds that each gets.

    Args:
        failed: The episodes that failed; none shows the first episode.
        seconds: The seconds of the sample.
    """
    chosen = (list(failed) or [0])[: max(1, int(seconds // LEAST_S))]
    return chosen, seconds / len(chosen)


def world_words(application: Application, mu: Mu, most: int = 3) -> str:
    """Name the parameters that are farthest from the middle of their ranges, with their values."""
    parameters = application.parameters.parameters
    values = application.parameters.physical(mu).tolist()
    far = sorted(range(len(mu)), key=lambda i: -abs(float(mu[i])))[:most]
    return ", ".join(parameters[i].text(values[i]) for i in sorted(far))


def steps_before(last: int, count: float) -> range:
    """Give the steps that end at `last`, and at most so many before it."""
    return range(max(0, last - max(1, round(count))), last + 1)
