"""Replays the samples of a run, and writes them as a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.analyses.replay.captions import captioned
from sada_gym.analyses.replay.choice import choose
from sada_gym.analyses.replay.clip import make_clip
from sada_gym.analyses.replay.gif import BYTES_PER_10_S, gif
from sada_gym.analyses.replay.mp4 import mp4, require_encoder
from sada_gym.analyses.replay.shots import Clip
from sada_gym.application import Application, isolated_rng
from sada_gym.errors import FileError, UserError, UserTypeError
from sada_gym.evaluations import Evaluations, fools
from sada_gym.experiment.packages import installed
from sada_gym.experiment.record import RunSettings
from sada_gym.foundations.files import as_path, write_file
from sada_gym.foundations.frames import Frame
from sada_gym.run import Run
from sada_gym.run.run import as_run

SECONDS = 10.0
MAX_SECONDS = 60.0
"""A video is kept in memory while it is made."""
CLOSE = 1e-4
"""Another processor rounds otherwise: a score may be so far from the stored one."""

_DRAWING = (
    "Without pictures the score is the stored one, so drawing changes the episode. Fix the "
    "environment's render, or what it does with a render_mode, so that it changes nothing."
)

Stage = Literal["open", "play", "write"]
OnProgress = Callable[[Stage, int, int], object]
"""Gets the stage, how many samples of it are done, and their number."""


@dataclass(frozen=True)
class ReplayedSample:
    """One sample, played again.

    Attributes:
        sample: Its row in samples.npz, from 0.
        score: Its Q now; `stored` is the Q in the run's files.
        endings: How each episode shown ends, such as `left its lane after 6.2 s`.
    """

    sample: int
    seed: int
    score: float
    stored: float
    fooled: bool
    endings: tuple[str, ...]


@dataclass(frozen=True)
class Video:
    """The video of samples that were played again.

    Attributes:
        frames: The frames, (height, width, 3) uint8. `times_s` says how long each is shown.
        samples: The samples that it shows, in this order.
        path: The file that was written, if any, of `size` bytes.
    """

    frames: tuple[Frame, ...]
    times_s: tuple[float, ...]
    samples: tuple[ReplayedSample, ...]
    path: Path | None = None
    size: int = 0

    @property
    def seconds(self) -> float:
        """How long the video takes."""
        return sum(self.times_s)


def replay(
    run: Run | str | Path,
    *,
    worst: int | None = None,
    sample: int | None = None,
    out: str | Path | None = None,
    application: Application | str | None = None,
    seconds: float = SECONDS,
    on_progress: OnProgress = lambda *_: None,
) -> Video:
    """Play samples of a run again, and write them as a video.

    Each sample must get the score that the run stored. The last frame of a failure stays for 1.5 s,
    with the reason. If an episode is a single image, the video goes from the nominal world to the
    world of the sample.

    Args:
        run: A run, or its folder.
        worst: How many of the samples with the lowest scores to show; None shows one.
        sample: The row of one sample in samples.npz, from 0, to show instead.
        out: The file to write, `.gif` or `.mp4`; None writes no file.
        application: What was attacked: an `Application`, an environment's id, or a TOML file. None
            opens what the run records.
        seconds: About how many seconds to show of each sample. Of a longer episode only the end is
            shown. If several episodes of a sample fail, they share this time.
        on_progress: Called with `open`, `play` or `write`, the samples done, and their number.

    Raises:
        UserError: If an argument is bad, the application is another one, or a score differs.
        FileError: If the folder holds no finished run, or the video cannot be written.
        MissingExtra: If an MP4 is wanted but imageio-ffmpeg is not installed.
    """
    path = None if out is None else _check_out(out)
    finished = as_run(run)
    samples = finished.samples
    rows = choose(samples, worst=worst, sample=sample)
    _check_seconds(seconds, len(rows))
    on_progress("open", 0, len(rows))
    timed: list[tuple[Frame, float]] = []
    played: list[ReplayedSample] = []
    with finished.open(application) as target:
        threshold = target.application.fooling_threshold
        for row in rows:
            on_progress("play", len(played), len(rows))
            clip = _play(target.application, samples, row, finished.settings, seconds)
            played.append(
                ReplayedSample(
                    sample=row,
                    seed=int(samples.seed[row]),
                    score=clip.score,
                    stored=float(samples.score[row]),
                    fooled=fools(clip.score, threshold),
                    endings=tuple(shot.ending for shot in clip.shots),
                )
            )
            last_line = f"sample {row}: Q = {clip.score:.2f}; fooled where Q ≤ {threshold:g}"
            for shot in clip.shots:
                timed.extend(captioned(shot, last_line))
    frames, times_s = zip(*timed, strict=True)
    video = Video(_same_height(frames), times_s, tuple(played), path)
    if path is None:
        return video
    on_progress("write", len(rows), len(rows))
    if path.suffix.lower() == ".mp4":
        content = mp4(video.frames, video.times_s)
    else:
        limit = round(BYTES_PER_10_S * max(1.0, video.seconds / 10.0))
        content = gif(video.frames, video.times_s, limit)
    write_file(path, content)
    return replace(video, size=len(content))


def _check_out(out: str | Path) -> Path:
    path = as_path(out, "the video")
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise UserError(f"Expected a file that ends in .gif or .mp4, got {path}.")
    if path.is_dir():
        raise FileError(f"Expected a file to write, got the folder {path}. Name a file in it.")
    if not path.absolute().parent.is_dir():
        raise FileError(
            f"Expected to write {path}, but its folder does not exist. Make the folder first."
        )
    if path.suffix.lower() == ".mp4":
        require_encoder()
    return path


def _check_seconds(seconds: float, count: int) -> None:
    if isinstance(seconds, bool) or not isinstance(seconds, int | float | np.number):
        raise UserTypeError(f"Expected seconds to be a number, got {seconds!r}.")
    if not 1.0 <= seconds <= MAX_SECONDS:
        raise UserError(f"Expected seconds from 1 to {MAX_SECONDS:g}, got {seconds:g}.")
    if seconds * count > MAX_SECONDS:
        raise UserError(
            f"Expected a video of at most {MAX_SECONDS:g} s, got {count} samples of {seconds:g} "
            f"s. Take --seconds {int(MAX_SECONDS / count) or 1}, or fewer samples."
        )


def _play(
    application: Application, samples: Evaluations, row: int, settings: RunSettings, seconds: float
) -> Clip:
    mu, threshold = samples.mu[row], application.fooling_threshold
    try:
        with isolated_rng(application):
            clip = make_clip(application, mu, int(samples.seed[row]), seconds)
    except NotImplementedError as error:
        raise UserError(
            f"Expected an application that draws pictures, got {application.name}: {error}"
        ) from error
    stored = float(samples.score[row])
    same_verdict = fools(clip.score, threshold) == fools(stored, threshold)
    differs = abs(clip.score - stored) > CLOSE or not same_verdict
    if application.repeatable and differs:
        undrawn = application.evaluate(samples.mu[row : row + 1], [int(samples.seed[row])]).score
        reason = _DRAWING if abs(float(undrawn[0]) - stored) <= CLOSE else _reason(settings)
        raise UserError(
            f"Expected Q = {stored:.6g} of sample {row}, as the run stored it, got "
            f"{clip.score:.6g}. {reason}"
        )
    return clip


def _reason(settings: RunSettings) -> str:
    changed = []
    for name, before in settings.packages.items():
        now = installed(name)
        if now != before:
            changed.append(f"{name} was {before} and is {now}")
    if changed:
        return f"Other versions are installed: {'; '.join(changed)}. Install those of the run."
    return (
        "The versions are those of the run, so this processor rounds differently, or the agent or "
        "the environment is random. Replay on the machine of the run, or use `sada-gym check`."
    )


def _same_height(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    height = max(map(len, frames))
    return tuple(
        np.pad(frame, ((0, height - len(frame)), (0, 0), (0, 0)), mode="edge") for frame in frames
    )
