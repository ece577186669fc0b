"""Writes a video as a GIF that loops, small enough for a web page.

One palette serves all frames, chosen so that small coloured things keep their colour.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from sada_gym.foundations.arrays import Bytes
from sada_gym.foundations.frames import Frame

COLOURS = 255
"""One of the 256 that a GIF can have stands for pixels that stay as they are."""
BYTES_PER_10_S = 2_000_000
_TRIES = (
    (1.0, 5.0, COLOURS),
    (1.0, 9.0, 160),
    (1.0, 12.0, 96),
    (0.9, 12.0, 96),
    (0.8, 12.0, 64),
    (0.65, 12.0, 48),
    (0.5, 12.0, 32),
)
"""Width as a share, how far a pixel's colour may be off before it changes, colours. Where none is
enough, every second frame is left out, and so on."""
_FAR = 1.6
_HELD_S = 1.0
"""Frames that stand so long are endings."""

_BITS = 6
"""Colours are counted on a grid of so many bits a channel."""
_RARE = 0.4
"""A colour that fills a hundred times the area gets 100 ** 0.4 times the weight."""


def gif(frames: Sequence[Frame], times_s: Sequence[float], max_bytes: int) -> bytes:
    """Return a video as the bytes of a GIF.

    All frames have one size and share one palette. A frame holds only those pixels that changed.
    Where the file would be too large, it gets fewer colours, a smaller picture and in the end fewer
    frames; it may still have more than `max_bytes`.
    """
    content = b""
    for kept, times in _thinned(frames, times_s):
        skip = False
        for share, tolerance, colours in _TRIES:
            if skip:  # far too large: the next try would not do
                skip = False
                continue
            scaled = kept if share == 1.0 else [_scaled(frame, share) for frame in kept]
            content = _encoded(scaled, times, tolerance, colours)
            if len(content) <= max_bytes:
                return content
            skip = len(content) > _FAR * max_bytes
    return content


def _thinned(
    frames: Sequence[Frame], times_s: Sequence[float]
) -> Iterator[tuple[Sequence[Frame], Sequence[float]]]:
    yield frames, times_s
    for share in (2, 3):  # keep every second, then every third frame, and all endings
        kept: list[Frame] = []
        times: list[float] = []
        together = 0
        for frame, time_s in zip(frames, times_s, strict=True):
            is_held = time_s >= _HELD_S
            if is_held or together in (0, share):
                kept.append(frame)
                times.append(time_s)
                together = 0 if is_held else 1
            else:
                kept[-1], times[-1] = frame, times[-1] + time_s
                together += 1
        yield kept, times


def _scaled(frame: Frame, share: float) -> Frame:
    height, width = (max(1, round(share * side)) for side in frame.shape[:2])
    picture = Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS)
    return np.asarray(picture)


def _encoded(
    frames: Sequence[Frame], times_s: Sequence[float], tolerance: float, colours: int
) -> bytes:
    palette = Palette(frames, colours)
    pictures = [Image.fromarray(indices) for indices in _steadied(frames, palette, tolerance)]
    for picture in pictures:
        picture.putpalette(palette.colours.tobytes())
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=durations_ms(times_s),
        loop=0,
        disposal=1,
        optimize=True,
    )
    return buffer.getvalue()


def _steadied(frames: Sequence[Frame], palette: Palette, tolerance: float) -> Iterator[Bytes]:
    """Yield each frame's indices, (height, width); a pixel keeps its index while that fits."""
    shown: Bytes | None = None
    colours = palette.colours.astype(np.int16)
    for frame in frames:
        indices = palette.indices(frame)
        if shown is not None:
            off = (colours[shown] - frame.astype(np.int16)).astype(np.float32)
            indices = np.where((off * off).sum(axis=2) <= 3 * tolerance**2, shown, indices)
        shown = indices
        yield indices


def durations_ms(times_s: Sequence[float]) -> list[int]:
    """Round times to the hundredths of a second that a GIF holds, so that the sum stays right."""
    ends = np.round(np.cumsum([0.0, *times_s]) * 100).astype(int)
    return [max(20, 10 * hundredths) for hundredths in np.diff(ends).tolist()]


class Palette:
    """At most `count` colours, (count, 3) uint8, that stand for all those of some frames."""

    def __init__(self, frames: Sequence[Frame], count: int) -> None:
        self._picture = _sample(frames).quantize(count, Image.Quantize.MEDIANCUT, kmeans=3)
        colours = self._picture.getpalette() or []
        self.colours: Bytes = np.array(colours, np.uint8).reshape(-1, 3)

    def indices(self, frame: Frame) -> Bytes:
        """Return the index of the nearest colour for each pixel, (height, width)."""
        picture = Image.fromarray(frame)
        found = picture.quantize(palette=self._picture, dither=Image.Dither.NONE)
        return np.asarray(found)


def _sample(frames: Sequence[Frame]) -> Image.Image:
    """Make a picture of the frames' colours in which those of small things have their share."""
    cells = 1 << 3 * _BITS
    counts, sums = np.zeros(cells), np.zeros((cells, 3))
    step = max(1, len(frames) // 40)
    for frame in [*frames[::step], frames[-1]]:
        pixels = frame.reshape(-1, 3)
        red, green, blue = (pixels.astype(np.int32) >> (8 - _BITS)).T
        cell = (red << 2 * _BITS) | (green << _BITS) | blue
        counts += np.bincount(cell, minlength=cells)
        for k in range(3):
            sums[:, k] += np.bincount(cell, pixels[:, k], minlength=cells)
    filled = np.flatnonzero(counts)
    colours = np.round(sums[filled] / counts[filled, None]).astype(np.uint8)
    shares = np.ceil(counts[filled] ** _RARE).astype(int)
    return Image.fromarray(np.repeat(colours, shares, axis=0)[None])
