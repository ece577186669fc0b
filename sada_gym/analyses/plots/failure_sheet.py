"""The sheet of failures: the worst, typical and different ones, with the frames' legend."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image, ImageDraw

from sada_gym.foundations.drawing import font, resized_into, stacked, swatch, wrapped
from sada_gym.foundations.frames import GRID, INK, MUTED, Frame, LegendEntry, rgb

WIDTH = 1400
"""The width of a sheet in pixels. It can be read at half of that."""

_MARGIN, _GAP = 24, 20
_HEADLINE, _HEADING, _TEXT, _SMALL = 32, 30, 24, 20  # font sizes
_LINE = 1.35
_SWATCH = (48, 26)
_MOST_COLUMNS, _READABLE = 4, 0.5
_TALLEST = 1.6  # times a cell's width


@dataclass(frozen=True)
class FrameGroup:
    """Some frames, each with a caption, under a heading and a few words on what the group is.

    What follows the first line of a caption is written smaller.
    """

    title: str
    note: str
    frames: Sequence[Frame]
    captions: Sequence[str]


def columns_for(frame: Frame, *, plain: bool = False) -> int:
    """Say how many frames stand in a row, 2 to 4, so that text in them can be read.

    A sheet that is shown at half its width shows them at half their size or larger. Frames on which
    nothing is written, `plain` ones, stand three in a row.
    """
    if plain:
        return 3
    return max(2, min(_MOST_COLUMNS, int(WIDTH / 2 / (_READABLE * frame.shape[1]))))


def failure_sheet(
    groups: Sequence[FrameGroup],
    columns: int,
    legend: Sequence[LegendEntry],
    title: str,
    headline: str = "",
) -> Image.Image:
    """Lay groups of frames out, so many in a row, under a headline, a title and their legend.

    Empty groups are left out; the legend may be empty.
    """
    strips = [_space(_MARGIN)]
    if headline:
        strips += [_text(headline, _HEADLINE, bold=True), _space(6)]
    strips += [_text(title, _TEXT, MUTED), _space(8), _legend(legend)]
    strips += [_text(entry.text, _TEXT) for entry in legend if entry.mark == "note"]
    for group in groups:
        starts = range(0, len(group.frames), columns)
        strips += [_heading(group)] if starts else []
        for row in (slice(start, start + columns) for start in starts):
            strips.append(_row(group.frames[row], group.captions[row], columns))
    return Image.fromarray(stacked([*strips, _space(_MARGIN - _GAP)]))


def png_of(picture: Image.Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    picture.save(buffer, format="png")
    return buffer.getvalue()


def _space(height: int) -> Image.Image:
    return Image.new("RGB", (WIDTH, height), "white")


def _text(text: str, size: int, colour: str = INK, *, bold: bool = False) -> Image.Image:
    face, height = font(size, bold=bold), round(_LINE * size)
    lines = wrapped(text, face, WIDTH - 2 * _MARGIN)
    strip = _space(height * len(lines))
    draw = ImageDraw.Draw(strip)
    for i, line in enumerate(lines):
        draw.text((_MARGIN, i * height), line, rgb(colour), face)
    return strip


def _heading(group: FrameGroup) -> Image.Image:
    bold, top = font(_HEADING, bold=True), 24
    strip = _space(top + round(1.5 * _HEADING))
    draw = ImageDraw.Draw(strip)
    draw.line([(_MARGIN, 10), (WIDTH - _MARGIN, 10)], rgb(GRID), 2)
    draw.text((_MARGIN, top + _HEADING), group.title, rgb(INK), bold, anchor="ls")
    place = (_MARGIN + bold.getlength(group.title) + 18, top + _HEADING)
    draw.text(place, group.note, rgb(MUTED), font(_TEXT), anchor="ls")
    return strip


def _legend(entries: Sequence[LegendEntry]) -> Image.Image:
    face, line, (width, height) = font(_TEXT), round(_LINE * _TEXT) + 8, _SWATCH
    left, top, places = _MARGIN, 0, []
    marks = [entry for entry in entries if entry.mark != "note"]
    for entry in marks:
        room = width + 12 + face.getlength(entry.text)
        if left > _MARGIN and left + room > WIDTH - _MARGIN:
            left, top = _MARGIN, top + line
        places.append((left, top))
        left = round(left + room + 36)
    strip = _space(top + line if marks else 0)
    draw = ImageDraw.Draw(strip)
    for entry, (left, top) in zip(marks, places, strict=True):
        above, right = top + (line - height) // 2, left + width
        swatch(draw, entry, (left, above, right, above + height))
        draw.text((right + 12, top + line // 2), entry.text, rgb(INK), face, anchor="lm")
    return strip


def _row(frames: Sequence[Frame], captions: Sequence[str], columns: int) -> Image.Image:
    cell = (WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) // columns
    pictures = [resized_into(Image.fromarray(frame), cell, _TALLEST * cell) for frame in frames]
    large, small = font(_TEXT), font(_SMALL)
    line, less = round(_LINE * _TEXT), round(_LINE * _SMALL)
    parts = [caption.partition("\n") for caption in captions]
    titles = [wrapped(first, large, cell) for first, _, _ in parts]
    texts = [wrapped(rest, small, cell) for _, _, rest in parts]
    heights = [line * len(a) + less * len(b) for a, b in zip(titles, texts, strict=True)]
    top = max(heights) + 6
    strip = _space(top + max(picture.height for picture in pictures) + _GAP)
    draw = ImageDraw.Draw(strip)
    for i, picture in enumerate(pictures):
        left, below = _MARGIN + i * (cell + _GAP), line * len(titles[i])
        for k, words in enumerate(titles[i]):
            draw.text((left, k * line), words, rgb(INK), large)
        for k, words in enumerate(texts[i]):
            draw.text((left, below + k * less), words, rgb(MUTED), small)
        strip.paste(picture, (left, top))
        corner = (left + picture.width - 1, top + picture.height - 1)
        draw.rectangle((left, top, *corner), outline=rgb(GRID))
    return strip
