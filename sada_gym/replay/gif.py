"""Writes a video as a GIF that loops, small enough for a web page."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from sada_gym.arrays import Bytes
from sada_gym.frames import Frame
from sada_gym.replay.palette import Palette

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
