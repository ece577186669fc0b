"""Detections as shots: camera, light and paint go from the nominal world to the attacked one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym.clips.captions import DONE, FAILED, INK, PAPER, SOFT, WIDTH
from sada_gym.clips.shots import MORPH_FPS, Clip, Shot, ShotEnding, path_to
from sada_gym.drawing import dashed_box, font
from sada_gym.envs.detection.frame import FLOOR
from sada_gym.evaluations import fools
from sada_gym.frames import ORANGE, SKY, Colour, rgb
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from sada_gym.envs.detection.application import DetectionApplication

SIDE = 270
_FINER = 2
_SEEN, _WRONG = rgb(SKY), rgb(ORANGE)
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 14, 44, 40
"""The margins of the chart."""

Detection = Mapping[str, Any]


def clip(application: DetectionApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the detector's answer changes on the way from mu = 0.

    The pictures are finer than what the detector gets, where the renderer can draw any size.
    """
    way = path_to(mu, seconds)
    outcomes = application.evaluate(way, [seed] * len(way))
    wanted, threshold = application.object_class, application.fooling_threshold
    names = application.class_names
    pictures, notes = [], []
    for i, (view, info) in enumerate(
        zip(_views(application, way, seed), outcomes.infos, strict=True)
    ):
        right, wrong = _best(info["detections"], application.label)
        picture = Image.new("RGB", (WIDTH, SIDE), INK)
        scale = SIDE * _FINER / application.image_size
        picture.paste(_boxed(view, scale, right, wrong, names), (0, 0))
        chart = _chart(outcomes.score[: i + 1], len(way), threshold, wanted)
        picture.paste(chart, (SIDE, 0))
        pictures.append(picture)
        notes.append(f"the detector says {_said(right, wrong, names, wanted)}")
    last = outcomes.infos[-1]
    said = _said(*_best(last["detections"], application.label), names, wanted)
    fooled = bool(last["fooled"])
    text = f"the detector says {said}" if fooled else f"still found: {said}"
    if fooled and said.startswith(f"{wanted},"):
        text = f"only {last['score']:.2f} sure of the {wanted}"
    world = _world(application, mu)
    ending = ShotEnding(text, fooled)
    return Clip([Shot(pictures, MORPH_FPS, notes, world, ending)], float(last["score"]))


def _world(application: DetectionApplication, mu: Mu) -> str:
    """Say where the camera and the light stand in the attacked world."""
    distance, azimuth, pitch, _, light, *_ = application.parameters.physical(mu).tolist()
    side = "right" if azimuth < 0 else "left"
    return (
        f"camera {abs(azimuth):.0f}° round to the {side}, {pitch:.0f}° up, {distance:.1f} away; "
        f"light {light:.0f}° up"
    )


def _views(application: DetectionApplication, way: Mu, seed: int) -> list[Image.Image]:
    side, renderer = SIDE * _FINER, application.renderer
    if renderer.any_size:
        renderings = renderer.render_batch([application.scene(row, seed) for row in way], side)
        return [Image.fromarray(rendering.image) for rendering in renderings]
    seen = [Image.fromarray(application.observation(row, seed)) for row in way]
    return [view.resize((side, side), Image.Resampling.BICUBIC) for view in seen]


def _best(detections: Sequence[Detection], label: int) -> tuple[Detection | None, Detection | None]:
    """Return the best detection of the class, and the best of others, as far as they are clear."""
    clear = [detection for detection in detections if detection["score"] >= FLOOR]
    right = next((detection for detection in clear if detection["label"] == label), None)
    return right, next((detection for detection in clear if detection["label"] != label), None)


def _confidence(detection: Detection) -> float:
    return float(detection["score"])


def _said(
    right: Detection | None, wrong: Detection | None, names: Mapping[int, str], wanted: str
) -> str:
    clear = [detection for detection in (right, wrong) if detection is not None]
    if not clear:
        return f"nothing: no {wanted}"
    best = max(clear, key=_confidence)
    return f"{names.get(best['label'], 'label ' + str(best['label']))}, {best['score']:.2f}"


def _boxed(
    view: Image.Image,
    scale: float,
    right: Detection | None,
    wrong: Detection | None,
    names: Mapping[int, str],
) -> Image.Image:
    """Draw the box of the class (blue) or of what the detector takes it for (orange, dashed)."""
    draw = ImageDraw.Draw(view)
    clear = [detection for detection in (right, wrong) if detection is not None]
    if clear:
        best = max(clear, key=_confidence)
        colour, dash, gap = (_WRONG, 19, 11) if best is wrong else (_SEEN, 1, 0)
        box = np.clip(scale * np.array(best["box"]), 3, view.width - 4).tolist()
        if box[0] < box[2] and box[1] < box[3]:
            dashed_box(draw, box, colour, 6, dash, gap)
            text = f"{names.get(best['label'], '?')} {best['score']:.2f}"
            _tag(draw, box, text, colour, view.width)
    return view.resize((SIDE, SIDE), Image.Resampling.BOX)


def _tag(
    draw: ImageDraw.ImageDraw, box: Sequence[float], text: str, colour: Colour, side: int
) -> None:
    """Write what a box is taken for, above it or, at the picture's edge, in it."""
    letters = font(13 * _FINER, bold=True)
    width, height = draw.textlength(text, letters) + 12, 17 * _FINER
    x = min(max(box[0], 0), side - width)
    y = box[1] - height if box[1] >= height else box[1]
    draw.rectangle((x, y, x + width, y + height), fill=colour)
    draw.text((x + 6, y + height / 2), text, fill=INK, font=letters, anchor="lm")


def _chart(
    scores: npt.NDArray[np.float64], count: int, threshold: float, wanted: str
) -> Image.Image:
    """Draw the detector's confidence in the class so far, and where it counts as fooled."""
    width, height = (WIDTH - SIDE) * _FINER, SIDE * _FINER
    left, right, top, bottom = (_FINER * margin for margin in (_LEFT, _RIGHT, _TOP, _BOTTOM))
    picture = Image.new("RGB", (width, height), (246, 247, 249))
    draw = ImageDraw.Draw(picture)

    def at(i: float, score: float) -> tuple[float, float]:
        x = left + (width - left - right) * i / (count - 1)
        return x, height - bottom - (height - top - bottom) * score

    small = font(11 * _FINER)
    draw.text(
        (10 * _FINER, 22 * _FINER),
        f"confidence in {wanted}",
        INK,
        font(12 * _FINER, bold=True),
        "lm",
    )
    below = (*at(0, threshold), *at(count - 1, 0))
    draw.rectangle(below, fill=(250, 226, 213))
    middle = at(count / 2, threshold / 2)
    draw.text(middle, "fooled", FAILED, font(12 * _FINER, bold=True), "mm")
    for level in (0.0, 0.5, 1.0):
        x, y = at(0, level)
        draw.line([(x, y), at(count - 1, level)], fill=SOFT, width=_FINER)
        draw.text((x - 6 * _FINER, y), f"{level:g}", INK, small, "rm")
    x, y = at(0, threshold)
    draw.line([(x, y), at(count - 1, threshold)], fill=FAILED, width=_FINER)
    draw.text((x - 6 * _FINER, y), f"{threshold:g}", FAILED, small, "rm")
    draw.text(at(0, -0.11), "usual", INK, small, "lm")
    draw.text(at(count - 1, -0.11), "attacked", INK, small, "rm")
    points = [at(i, float(score)) for i, score in enumerate(scores)]
    if len(points) > 1:
        draw.line(points, fill=INK, width=3 * _FINER, joint="curve")
    colour = FAILED if fools(scores[-1], threshold) else DONE
    draw.circle(points[-1], 6 * _FINER, colour, PAPER, 2 * _FINER)
    return picture.resize((WIDTH - SIDE, SIDE), Image.Resampling.LANCZOS)
