"""The sheet of failures: the worst, typical and different ones, with the frames' legend."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image, ImageDraw

from sada_gym.drawing import font, swatch, wrapped
from sada_gym.frames import GRID, INK, MUTED, Frame, LegendEntry, rgb

WIDTH = 1400
"""The width of a sheet in pixels. It can be read at half of that."""

_MARGIN, _GAP = 24, 20
_HEADLINE, _HEADING, _TEXT = 32, 30, 24  # font sizes
_LINE = 1.35
_SWATCH = (48, 26)
_MOST_COLUMNS, _READABLE = 4, 0.5
_TALLEST = 1.6  # times a cell's width


@dataclass(frozen=True)
class FrameGroup:
    """Some frames under a heading.

    Attributes:
        title: The heading, such as `Worst`.
        note: A few words that say what the group is.
        frames: RGB images.
        captions: A short line for each.
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
    """Lay groups of frames out below one another, under a headline and the frames' legend.

    Args:
        groups: The groups; empty ones are left out.
        columns: The number of frames in a row.
        legend: The marks in the frames; may be empty.
        title: A line above the legend.
        headline: A sentence or two on top.
    """
    page = _Page()
    if headline:
        page.write(headline, _HEADLINE, bold=True)
        page.top += 6
    page.write(title, _TEXT, colour=MUTED)
    page.top += 8
    page.legend(legend)
    for group in filter(lambda group: len(group.frames), groups):
        page.rule()
        page.heading(group.title, group.note)
        for first in range(0, len(group.frames), columns):
            row = slice(first, first + columns)
            page.row(group.frames[row], group.captions[row], columns)
    return page.finished()


def png_of(picture: Image.Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    picture.save(buffer, format="png")
    return buffer.getvalue()


class _Page:
    """A white page that grows as things are put below one another."""

    def __init__(self) -> None:
        self._picture = Image.new("RGB", (WIDTH, 2 * WIDTH), "white")
        self.top = _MARGIN
        self._grow(0)

    def _grow(self, room: int) -> None:
        if self.top + room > self._picture.height:
            taller = Image.new("RGB", (WIDTH, 2 * (self.top + room)), "white")
            taller.paste(self._picture, (0, 0))
            self._picture = taller
        self._draw = ImageDraw.Draw(self._picture)

    def write(self, text: str, size: int, *, bold: bool = False, colour: str = INK) -> None:
        face = font(size, bold=bold)
        for line in wrapped(text, face, WIDTH - 2 * _MARGIN):
            self._grow(2 * size)
            self._draw.text((_MARGIN, self.top), line, rgb(colour), face)
            self.top += round(_LINE * size)

    def rule(self) -> None:
        self.top += 10
        self._grow(20)
        ends = [(_MARGIN, self.top), (WIDTH - _MARGIN, self.top)]
        self._draw.line(ends, rgb(GRID), 2)
        self.top += 14

    def heading(self, title: str, note: str) -> None:
        bold, plain = font(_HEADING, bold=True), font(_TEXT)
        self._grow(2 * _HEADING)
        base = self.top + _HEADING
        self._draw.text((_MARGIN, base), title, rgb(INK), bold, anchor="ls")
        after = _MARGIN + bold.getlength(title) + 18
        self._draw.text((after, base), note, rgb(MUTED), plain, anchor="ls")
        self.top += round(1.5 * _HEADING)

    def legend(self, entries: Sequence[LegendEntry]) -> None:
        """Draw marks, each before what it means, in as many lines as they need; then the notes."""
        face, right = font(_TEXT), WIDTH - _MARGIN
        width, height = _SWATCH
        line = round(_LINE * _TEXT) + 8
        left = _MARGIN
        for entry in entries:
            if entry.mark == "note":
                continue
            room = width + 12 + face.getlength(entry.text)
            if left > _MARGIN and left + room > right:
                left, self.top = _MARGIN, self.top + line
            self._grow(line)
            top = self.top + (line - height) // 2
            swatch(self._draw, entry, (left, top, left + width, top + height))
            middle = (left + width + 12, self.top + line // 2)
            self._draw.text(middle, entry.text, rgb(INK), face, anchor="lm")
            left = round(left + room + 36)
        self.top += line if left > _MARGIN else 0
        for entry in entries:
            if entry.mark == "note":
                self.write(entry.text, _TEXT)

    def row(self, frames: Sequence[Frame], captions: Sequence[str], columns: int) -> None:
        """Put frames beside one another, each with its caption above."""
        cell = (WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) // columns
        pictures = [_fitted(frame, cell) for frame in frames]
        face, line = font(_TEXT), round(_LINE * _TEXT)
        texts = [wrapped(caption, face, cell) for caption in captions]
        above = line * max(map(len, texts)) + 6
        height = above + max(picture.height for picture in pictures) + _GAP
        self._grow(height)
        for i, (picture, lines) in enumerate(zip(pictures, texts, strict=True)):
            left, top = _MARGIN + i * (cell + _GAP), self.top + above
            for k, words in enumerate(lines):
                self._draw.text((left, self.top + k * line), words, rgb(INK), face)
            self._picture.paste(picture, (left, top))
            corner = (left + picture.width - 1, top + picture.height - 1)
            self._draw.rectangle((left, top, *corner), outline=rgb(GRID))
        self.top += height

    def finished(self) -> Image.Image:
        """Return the page without the room below."""
        return self._picture.crop((0, 0, WIDTH, self.top + _MARGIN - _GAP))


def _fitted(frame: Frame, width: int) -> Image.Image:
    """Scale a frame to a cell's width; small ones keep their pixels' edges."""
    height, across = frame.shape[:2]
    scale = min(width / across, _TALLEST * width / height)
    size = (max(1, round(across * scale)), max(1, round(height * scale)))
    how = Image.Resampling.NEAREST if scale >= 2 else Image.Resampling.LANCZOS
    return Image.fromarray(frame).resize(size, how)
