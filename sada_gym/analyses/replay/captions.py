"""Puts words below a video's pictures and marks into them: one style for all applications."""

from __future__ import annotations

from collections.abc import Iterator

from PIL import Image, ImageDraw

from sada_gym.analyses.replay.shots import Shot
from sada_gym.foundations import drawing
from sada_gym.foundations.drawing import INK_RGB, font, resized_into, stacked
from sada_gym.foundations.frames import Colour, Frame

WIDTH = 640
"""The width of a video in pixels."""
MAX_HEIGHT = 400
"""Pictures are not drawn higher than this."""
HOLD_S = 1.5
"""The time for which an ending stands."""

INK, PAPER, SOFT = INK_RGB, (255, 255, 255), (190, 199, 208)
FAILED, DONE = (194, 65, 12), (0, 98, 155)
"""Orange and blue, which colour-blind people tell apart, dark enough for white letters on them; a
cross and a tick say the same."""

BAR = 54
_EDGE = 4
_LEFT, _FIRST, _SECOND = 10, 16, 38
_MARK = 7


def captioned(shot: Shot, last_line: str) -> Iterator[tuple[Frame, float]]:
    """Yield each frame of a shot with its time in seconds; the last one tells the ending."""
    for i, (picture, note) in enumerate(zip(shot.pictures, shot.notes, strict=True)):
        fitted = fit(picture)
        yield stacked([fitted, _bar(note, shot.world)]), 1.0 / shot.fps
        if i == len(shot.pictures) - 1:
            colour = FAILED if shot.failed else DONE
            ImageDraw.Draw(fitted).rectangle(
                (0, 0, fitted.width - 1, fitted.height - 1), outline=colour, width=_EDGE
            )
            yield stacked([fitted, _ending_bar(shot, last_line, colour)]), HOLD_S


def fit(picture: Image.Image) -> Image.Image:
    """Return a picture of the video's width: scaled, and on a dark ground where it is too high."""
    scaled = resized_into(picture, WIDTH, MAX_HEIGHT)
    ground = Image.new("RGB", (WIDTH, scaled.height), INK)
    ground.paste(scaled, ((WIDTH - scaled.width) // 2, 0))
    return ground


def _bar(note: str, world: str) -> Image.Image:
    bar = Image.new("RGB", (WIDTH, BAR), INK)
    draw = ImageDraw.Draw(bar)
    _write(draw, _LEFT, _FIRST, note, 15, PAPER)
    _write(draw, _LEFT, _SECOND, world, 12, SOFT)
    return bar


def _ending_bar(shot: Shot, last_line: str, colour: Colour) -> Image.Image:
    bar = Image.new("RGB", (WIDTH, BAR), colour)
    draw = ImageDraw.Draw(bar)
    x, y, width = _LEFT + _MARK, _FIRST, 3
    if shot.failed:
        drawing.cross(draw, (x, y), _MARK, PAPER, (width, width))
    else:
        tick = [(x - _MARK, y), (x - _MARK / 3, y + _MARK * 0.8), (x + _MARK, y - _MARK)]
        draw.line(tick, fill=PAPER, width=width, joint="curve")
    _write(draw, _LEFT + 3 * _MARK, _FIRST, shot.ending, 17, PAPER, bold=True)
    _write(draw, _LEFT, _SECOND, last_line, 12, PAPER)
    return bar


def _write(
    draw: ImageDraw.ImageDraw,
    left: int,
    middle: int,
    text: str,
    size: int,
    colour: Colour,
    *,
    bold: bool = False,
) -> None:
    room = WIDTH - left - _LEFT
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    for smaller in range(5):
        face = font(size - smaller, bold=bold)
        if draw.textlength(line, face) <= room:
            break
    else:
        while line and draw.textlength(f"{line}…", face) > room:
            line = line[:-1]
        line = f"{line.rstrip()}…"
    draw.text((left, middle), line, fill=colour, font=face, anchor="lm")
