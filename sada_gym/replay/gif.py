"""Writes a video as a GIF that loops, small enough for a web page.

One palette serves all frames, chosen so that small coloured things keep their colour.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.arrays import Bytes, Floats
from sada_gym.frames import Frame

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
"""Colours are looked up, and counted, on a grid of so many bits a channel."""
_MAX_COLOURS = 6_000
_RARE = 0.4
"""A colour that fills a hundred times the area gets 100 ** 0.4 times the weight."""

# Oklab (Ottosson, 2020): lightness and two hues, in which distances are as people see them
_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


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
        from scipy.spatial import cKDTree

        self.colours = _cluster(*_histogram(frames), count)
        levels = (np.arange(1 << _BITS) + 0.5) * (256 / (1 << _BITS))
        grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
        _, nearest = cKDTree(_oklab(self.colours.astype(np.float64))).query(_oklab(grid))
        self._nearest: Bytes = nearest.astype(np.uint8)

    def indices(self, frame: Frame) -> Bytes:
        """Return the index of the nearest colour for each pixel, (height, width)."""
        return np.asarray(self._nearest[_cells(frame)])


def _cells(pixels: Bytes) -> npt.NDArray[np.int32]:
    red, green, blue = (pixels[..., k].astype(np.int32) >> (8 - _BITS) for k in range(3))
    return np.asarray((red << 2 * _BITS) | (green << _BITS) | blue)


def _histogram(frames: Sequence[Frame]) -> tuple[Floats, Floats]:
    """Return the mean colours of the cells of a coarse grid, (n, 3), and their weights, (n,)."""
    cells = 1 << 3 * _BITS
    counts, sums = np.zeros(cells), np.zeros((cells, 3))
    step = max(1, len(frames) // 40)
    for frame in [*frames[::step], frames[-1]]:
        pixels = frame.reshape(-1, 3)
        cell = _cells(pixels)
        counts += np.bincount(cell, minlength=cells)
        for k in range(3):
            sums[:, k] += np.bincount(cell, pixels[:, k], minlength=cells)
    filled = np.flatnonzero(counts)
    filled = filled[np.argsort(-counts[filled], kind="stable")][:_MAX_COLOURS]
    return sums[filled] / counts[filled, None], counts[filled] ** _RARE


def _cluster(colours: Floats, weights: Floats, count: int) -> Bytes:
    if len(colours) <= count:
        return np.round(colours).astype(np.uint8)
    from sklearn.cluster import KMeans

    means = KMeans(count, n_init=1, max_iter=30, random_state=0)
    means.fit(_oklab(colours), sample_weight=weights)
    # the mean of the colours themselves, not in Oklab, which need not be turned back
    total = np.bincount(means.labels_, weights, minlength=count)
    sums = [np.bincount(means.labels_, weights * colours[:, k], minlength=count) for k in range(3)]
    used = total > 0
    return np.round(np.stack(sums, axis=1)[used] / total[used, None]).astype(np.uint8)


def _oklab(colours: Floats) -> Floats:
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.cbrt(linear @ _TO_CONES.T) @ _TO_LAB.T)
