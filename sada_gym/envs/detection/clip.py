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
from sada_gym.frames import ORANGE, SKY, rgb
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
    path = path_to(mu, seconds)
    outcomes = application.evaluate(path, [seed] * len(path))
    wanted, threshold = application.object_class, application.fooling_threshold
    scale = SIDE * _FINER / application.image_size
    pictures, answers = [], []
    for i, (view, info) in enumerate(
        zip(_views(application, path, seed), outcomes.infos, strict=True)
    ):
        best = _best(info["detections"], application.label)
        label = best and application.class_names.get(best["label"], f"label {best['label']}")
        answers.append(f"{label}, {best['score']:.2f}" if best else f"nothing: no {wanted}")
        if best is not None:
            name = application.class_names.get(best["label"], "?")
            _box(view, scale, best, f"{name} {best['score']:.2f}", application.label)
        picture = Image.new("RGB", (WIDTH, SIDE), INK)
        picture.paste(view.resize((SIDE, SIDE), Image.Resampling.BOX), (0, 0))
        picture.paste(_chart(outcomes.score[: i + 1], len(path), threshold, wanted), (SIDE, 0))
        pictures.append(picture)
    score, fooled = float(outcomes.score[-1]), bool(outcomes.fooled[-1])
    text = f"the detector says {answers[-1]}" if fooled else f"still found: {answers[-1]}"
    if fooled and answers[-1].startswith(f"{wanted},"):
        text = f"only {score:.2f} sure of the {wanted}"
    scene = application.scene(mu, seed)
    azimuth = scene.camera_azimuth_deg
    world = (
        f"camera {abs(azimuth):.0f}° round to the {'right' if azimuth < 0 else 'left'}, "
        f"{scene.camera_pitch_deg:.0f}° up, {scene.camera_distance:.1f} away; light "
        f"{scene.light_pitch_deg:.0f}° up"
    )
    notes = [f"the detector says {answer}" for answer in answers]
    return Clip([Shot(pictures, MORPH_FPS, notes, world, ShotEnding(text, fooled))], score)


def _views(application: DetectionApplication, way: Mu, seed: int) -> list[Image.Image]:
    side, renderer = SIDE * _FINER, application.renderer
    if renderer.any_size:
        renderings = renderer.render_batch([application.scene(row, seed) for row in way], side)
        return [Image.fromarray(rendering.image) for rendering in renderings]
    seen = [Image.fromarray(application.observation(row, seed)) for row in way]
    return [view.resize((side, side), Image.Resampling.BICUBIC) for view in seen]


def _best(detections: Sequence[Detection], label: int) -> Detection | None:
    """Return the clearest of the best detection of the class and the best of others."""
    clear = [detection for detection in detections if detection["score"] >= FLOOR]
    right = [detection for detection in clear if detection["label"] == label][:1]
    wrong = [detection for detection in clear if detection["label"] != label][:1]
    return max(right + wrong, key=lambda detection: float(detection["score"]), default=None)


def _box(view: Image.Image, scale: float, best: Detection, text: str, label: int) -> None:
    """Draw a box: blue for the class, else orange and dashed; and above it or in it the text."""
    colour, dash, gap = (_SEEN, 1, 0) if best["label"] == label else (_WRONG, 19, 11)
    box = np.clip(scale * np.array(best["box"]), 3, view.width - 4).tolist()
    if not (box[0] < box[2] and box[1] < box[3]):
        return
    draw, letters = ImageDraw.Draw(view), font(13 * _FINER, bold=True)
    dashed_box(draw, box, colour, 6, dash, gap)
    width, height = draw.textlength(text, letters) + 12, 17 * _FINER
    x = min(max(box[0], 0), view.width - width)
    y = box[1] - height if box[1] >= height else box[1]
    draw.rectangle((x, y, x + width, y + height), fill=colour)
    draw.text((x + 6, y + height / 2), text, fill=INK, font=letters, anchor="lm")


def _chart(
    scores: npt.NDArray[np.float64], count: int, threshold: float, wanted: str
) -> Image.Image:
    width, height = (WIDTH - SIDE) * _FINER, SIDE * _FINER
    left, right, top, bottom = (_FINER * margin for margin in (_LEFT, _RIGHT, _TOP, _BOTTOM))
    picture = Image.new("RGB", (width, height), (246, 247, 249))
    draw = ImageDraw.Draw(picture)

    def at(i: float, score: float) -> tuple[float, float]:
        x = left + (width - left - right) * i / (count - 1)
        return x, height - bottom - (height - top - bottom) * score

    small, bold = font(11 * _FINER), font(12 * _FINER, bold=True)
    draw.text((10 * _FINER, 22 * _FINER), f"confidence in {wanted}", INK, bold, "lm")
    below = (*at(0, threshold), *at(count - 1, 0))
    draw.rectangle(below, fill=(250, 226, 213))
    draw.text(at(count / 2, threshold / 2), "fooled", FAILED, bold, "mm")
    levels = [(level, SOFT, INK) for level in (0.0, 0.5, 1.0)] + [(threshold, FAILED, FAILED)]
    for level, line, ink in levels:
        x, y = at(0, level)
        draw.line([(x, y), at(count - 1, level)], fill=line, width=_FINER)
        draw.text((x - 6 * _FINER, y), f"{level:g}", ink, small, "rm")
    draw.text(at(0, -0.11), "usual", INK, small, "lm")
    draw.text(at(count - 1, -0.11), "attacked", INK, small, "rm")
    points = [at(i, float(score)) for i, score in enumerate(scores)]
    if len(points) > 1:
        draw.line(points, fill=INK, width=3 * _FINER, joint="curve")
    colour = FAILED if fools(scores[-1], threshold) else DONE
    draw.circle(points[-1], 6 * _FINER, colour, PAPER, 2 * _FINER)
    return picture.resize((WIDTH - SIDE, SIDE), Image.Resampling.LANCZOS)
