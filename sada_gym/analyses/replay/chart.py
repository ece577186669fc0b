"""The chart beside a film of single images: Q on the way to the world."""

from __future__ import annotations

from PIL import Image, ImageDraw

from sada_gym.analyses.replay.captions import DONE, FAILED, INK, PAPER, SOFT
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import font

_FINER = 2
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 14, 44, 40
_GROUND, _FOOLED = (246, 247, 249), (250, 226, 213)


def score_chart(scores: Floats, count: int, threshold: float, size: tuple[int, int]) -> Image.Image:
    """Draw the first scores, (k,), of a way of `count` worlds, against the fooling threshold."""
    width, tall = (_FINER * side for side in size)
    left, right, top, bottom = (_FINER * margin for margin in (_LEFT, _RIGHT, _TOP, _BOTTOM))
    picture = Image.new("RGB", (width, tall), _GROUND)
    draw = ImageDraw.Draw(picture)

    def at(i: float, score: float) -> tuple[float, float]:
        x = left + (width - left - right) * i / (count - 1)
        return x, tall - bottom - (tall - top - bottom) * score

    small, bold = font(11 * _FINER), font(12 * _FINER, bold=True)
    draw.text((10 * _FINER, 22 * _FINER), "score Q", INK, bold, "lm")
    draw.rectangle((*at(0, threshold), *at(count - 1, 0)), fill=_FOOLED)
    draw.text(at(count / 2, threshold / 2), "fooled", FAILED, bold, "mm")
    levels = [(level, SOFT, INK) for level in (0.0, 0.5, 1.0)] + [(threshold, FAILED, FAILED)]
    for level, line, ink in levels:
        x, y = at(0, level)
        draw.line([(x, y), at(count - 1, level)], fill=line, width=_FINER)
        draw.text((x - 6 * _FINER, y), f"{level:g}", ink, small, "rm")
    end = tall - 20 * _FINER
    draw.text((left, end), "nominal", INK, small, "lm")
    draw.text((width - right, end), "attacked", INK, small, "rm")
    points = [at(i, float(score)) for i, score in enumerate(scores)]
    if len(points) > 1:
        draw.line(points, fill=INK, width=3 * _FINER, joint="curve")
    colour = FAILED if fools(float(scores[-1]), threshold) else DONE
    draw.circle(points[-1], 6 * _FINER, colour, PAPER, 2 * _FINER)
    return picture.resize(size, Image.Resampling.LANCZOS)
