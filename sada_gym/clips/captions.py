"""Puts the words below a video's pictures: one width, one style, for all applications."""

from __future__ import annotations

from collections.abc import Iterator

from PIL import Image, ImageDraw

from sada_gym.clips.shots import Shot
from sada_gym.drawing import INK_RGB, font, stacked
from sada_gym.frames import Colour, Frame

WIDTH = 480
"""The width of a video in pixels."""
TALLEST = 400
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
    """Give each frame of a shot with its time in seconds; the last one tells the ending.

    Args:
        shot: The shot.
        last_line: The line below the ending.
    """
    for i, (picture, note) in enumerate(zip(shot.pictures, shot.notes, strict=True)):
        fitted = fit(picture)
        yield stacked([fitted, _bar(note, shot.world)]), 1.0 / shot.fps
        if i == len(shot.pictures) - 1:
            colour = FAILED if shot.ending.failed else DONE
            ImageDraw.Draw(fitted).rectangle(
                (0, 0, fitted.width - 1, fitted.height - 1), outline=colour, width=_EDGE
            )
            yield stacked([fitted, _ending_bar(shot, last_line, colour)]), HOLD_S


def fit(picture: Image.Image) -> Image.Image:
    """Give a picture of the video's width: scaled, and on a dark ground where it is too high."""
    scale = min(WIDTH / picture.width, TALLEST / picture.height)
    # the pixels of small pictures, such as those of games, stay sharp
    way = Image.Resampling.NEAREST if scale >= 2 else Image.Resampling.LANCZOS
    size = max(1, round(picture.width * scale)), max(1, round(picture.height * scale))
    scaled = picture if size == picture.size else picture.resize(size, way)
    ground = Image.new("RGB", (WIDTH, size[1]), INK)
    ground.paste(scaled, ((WIDTH - size[0]) // 2, 0))
    return ground


def mark(draw: ImageDraw.ImageDraw, x: float, y: float, size: float, *, failed: bool) -> None:
    """Draw a cross, or a tick, in white around a place."""
    width = max(2, round(size / 2.5))
    if failed:
        for up in (-size, size):
            draw.line([(x - size, y - up), (x + size, y + up)], fill=PAPER, width=width)
    else:
        corners = [(x - size, y), (x - size / 3, y + size * 0.8), (x + size, y - size)]
        draw.line(corners, fill=PAPER, width=width, joint="curve")


def cross(draw: ImageDraw.ImageDraw, x: float, y: float, size: float) -> None:
    """Mark a place where something failed: an orange cross with a white rim."""
    for colour, width in ((PAPER, round(size)), (FAILED, round(size / 2))):
        for up in (-size, size):
            draw.line([(x - size, y - up), (x + size, y + up)], fill=colour, width=max(2, width))


def ring(draw: ImageDraw.ImageDraw, x: float, y: float, radius: float) -> None:
    """Mark a place by an orange ring with a white rim, and leave what is there to be seen."""
    draw.circle((x, y), radius + 2, outline=PAPER, width=8)
    draw.circle((x, y), radius, outline=FAILED, width=4)


def _bar(note: str, world: str) -> Image.Image:
    bar = Image.new("RGB", (WIDTH, BAR), INK)
    draw = ImageDraw.Draw(bar)
    _write(draw, _LEFT, _FIRST, note, 15, PAPER)
    _write(draw, _LEFT, _SECOND, world, 12, SOFT)
    return bar


def _ending_bar(shot: Shot, last_line: str, colour: Colour) -> Image.Image:
    bar = Image.new("RGB", (WIDTH, BAR), colour)
    draw = ImageDraw.Draw(bar)
    mark(draw, _LEFT + _MARK, _FIRST, _MARK, failed=shot.ending.failed)
    _write(draw, _LEFT + 3 * _MARK, _FIRST, shot.ending.text, 17, PAPER, bold=True)
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
    """Write a line, smaller where it is too long, and cut where it is far too long."""
    room = WIDTH - left - _LEFT
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    least = size - 4
    while size > least and draw.textlength(line, font(size, bold=bold)) > room:
        size -= 1
    chosen = font(size, bold=bold)
    if draw.textlength(line, chosen) > room:
        while line and draw.textlength(f"{line}…", chosen) > room:
            line = line[:-1]
        line = f"{line.rstrip()}…"
    draw.text((left, middle), line, fill=colour, font=chosen, anchor="lm")
