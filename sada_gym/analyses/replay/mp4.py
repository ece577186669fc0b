"""Writes a video as an MP4 that browsers and slides play."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sada_gym.errors import FileError, MissingExtra, install_line
from sada_gym.foundations.frames import Frame

FPS = 20


def require_encoder() -> None:
    """Check that there is an encoder.

    Raises:
        MissingExtra: If imageio-ffmpeg is not installed.
    """
    try:
        import imageio_ffmpeg  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtra(
            "Expected imageio-ffmpeg to write an MP4, but it is not installed. "
            f"{install_line('video')}. Or write a .gif, which needs nothing else."
        ) from error


def mp4(frames: Sequence[Frame], times_s: Sequence[float]) -> bytes:
    """Return a video, whose frames have one size, as the bytes of an MP4 (H.264).

    Raises:
        MissingExtra: If imageio-ffmpeg is not installed.
        FileError: If its encoder fails.
    """
    require_encoder()
    import imageio_ffmpeg

    height, width = frames[0].shape[:2]
    odd = ((0, height % 2), (0, width % 2), (0, 0))  # H.264 takes even sides
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "video.mp4")
        writer = imageio_ffmpeg.write_frames(
            str(path),
            (width + width % 2, height + height % 2),
            fps=FPS,
            codec="libx264",
            pix_fmt_out="yuv420p",
            quality=None,
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=["-crf", "20", "-preset", "slow", "-movflags", "+faststart"],
        )
        try:
            writer.send(None)
            for frame in _at_one_rate(frames, times_s):
                writer.send(np.ascontiguousarray(np.pad(frame, odd, mode="edge")))
            writer.close()
            return path.read_bytes()
        except OSError as error:
            raise FileError(
                f"Expected ffmpeg to write an MP4, but it failed: {error}. Write a .gif instead."
            ) from error


def _at_one_rate(frames: Sequence[Frame], times_s: Sequence[float]) -> Iterator[Frame]:
    ends = np.round(np.cumsum([0.0, *times_s]) * FPS).astype(int)
    for frame, count in zip(frames, np.diff(ends).tolist(), strict=True):
        for _ in range(count):
            yield frame
