"""Small pictures of a run's worlds, which thumbnails.zip keeps."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.analyses.replay.clip import has_takes
from sada_gym.application import Application, isolated_rng
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.files import read_file, write_file
from sada_gym.foundations.frames import Frame, as_frame

THUMBNAILS_FILE = "thumbnails.zip"

_WIDTH, _HEIGHT, _QUALITY = 560, 480, 68
_METHOD = 2  # 4, the default, takes twice as long for 4 % fewer bytes
_FRAMES, _FRAME_WIDTH, _GAP = 5, 260, 128  # of a film strip
_MOST_BYTES = 4_000_000
"""The most bytes of pictures: a report of one run or two, which writes them as text, a third
longer, stays below 10 MB with its plots and numbers."""
_MOST_DRAWN, _SHARE = 24, 50
"""An attack draws a further picture for so many evaluations each, and not more than 24."""


@dataclass(frozen=True, eq=False)
class PicturedWorld:
    """A world that was evaluated: mu, (d,), its seed, Q, and its row among the samples, if any.

    Its picture is a frame, or a strip of frames of its episode.
    """

    mu: Floats32
    seed: int
    score: float
    row: int | None = None
    is_film: bool = False

    @property
    def key(self) -> str:
        """The name of its picture, or of its film strip."""
        mu = np.ascontiguousarray(self.mu, "<f4").tobytes()
        seed = self.seed.to_bytes(8, "little", signed=True)
        return hashlib.blake2b(mu + seed, digest_size=8).hexdigest() + "-film" * self.is_film


def sample(samples: Evaluations, row: int) -> PicturedWorld:
    """Return a test sample by its row."""
    return PicturedWorld(samples.mu[row], int(samples.seed[row]), float(samples.score[row]), row)


def picture_of(frame: Frame, width: int = _WIDTH) -> bytes:
    """Return a frame as a small WebP."""
    image, buffer = Image.fromarray(frame), io.BytesIO()
    image.thumbnail((width, _HEIGHT))
    image.save(buffer, "webp", quality=_QUALITY, method=_METHOD)
    return buffer.getvalue()


def strip_of(application: Application, world: PicturedWorld) -> bytes:
    """Return a film strip of a world's episode as a small WebP: of several, one that failed."""
    takes, _ = application.takes(world.mu, world.seed)  # type: ignore[attr-defined]
    take = next((take for take in takes if take.failed), takes[0])
    steps = np.linspace(0, take.count - 1, min(_FRAMES, take.count)).round().astype(int)
    frames = [as_frame(take.draw(step)[0], application.name) for step in steps.tolist()]
    gap = np.full((len(frames[0]), max(1, frames[0].shape[1] // 60), 3), _GAP, np.uint8)
    parts = [part for frame in frames for part in (gap, frame)][1:]
    return picture_of(np.concatenate(parts, axis=1), _FRAMES * _FRAME_WIDTH)


def read_thumbnails(folder: Path) -> dict[str, bytes]:
    """Read thumbnails by `PicturedWorld.key`; none where their file is missing or damaged."""
    path = folder / THUMBNAILS_FILE
    if not path.is_file():
        return {}
    try:
        content = read_file(path, 3 * _MOST_BYTES)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            stored = [one for one in archive.infolist() if one.compress_type == zipfile.ZIP_STORED]
            pictures = {one.filename.removesuffix(".webp"): archive.read(one) for one in stored}
    except (ValueError, zipfile.BadZipFile, zlib.error, OSError, RuntimeError, EOFError):
        return {}
    return {key: picture for key, picture in pictures.items() if picture[8:12] == b"WEBP"}


def write_thumbnails(folder: Path, pictures: Mapping[str, bytes]) -> dict[str, bytes]:
    """Write thumbnails, the first ones as far as there is room, and return those written."""
    kept, buffer = fitting(pictures), io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for key, picture in kept.items():
            archive.writestr(zipfile.ZipInfo(f"{key}.webp"), picture)  # without a date
    write_file(folder / THUMBNAILS_FILE, buffer.getvalue())
    return kept


def fitting(pictures: Mapping[str, bytes], runs: int = 1) -> dict[str, bytes]:
    """Return the first pictures of a run, as far as a page of so many runs has room."""
    kept, size = {}, 0
    for key, picture in pictures.items():
        size += len(picture)
        if size > _MOST_BYTES // runs:
            break
        kept[key] = picture
    return kept


def draw(
    application: Application,
    worlds: Sequence[PicturedWorld],
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> dict[str, bytes]:
    """Draw worlds; an application without pictures draws none, one that fails those before.

    `on_progress` is called after each with the numbers of pictures drawn and of all.
    """
    drawn: dict[str, bytes] = {}
    films = [world for world in worlds if world.is_film] if has_takes(application) else []
    filmed = {replace(world, is_film=False).key for world in films}
    single = [world for world in worlds if not world.is_film and world.key not in filmed]
    if not application.can_render or not (count := len(films) + len(single)):
        return drawn
    try:
        with isolated_rng(application):
            for world in films:
                drawn[world.key] = strip_of(application, world)
                on_progress(len(drawn), count)
            mu = np.array([world.mu for world in single]).reshape(-1, len(worlds[0].mu))
            frames = application.render_batch(mu, [world.seed for world in single])
            for world, frame in zip(single, frames, strict=True):
                drawn[world.key] = picture_of(as_frame(frame, application.name))
                on_progress(len(drawn), count)
    except Exception:  # a user's code: the sheet of failures tells what is wrong with it
        return drawn
    return drawn


def spread(samples: Evaluations, threshold: float, count: int) -> list[PicturedWorld]:
    """Choose so many samples evenly over the scores: half of them failures, if there are."""
    order = np.argsort(samples.score, kind="stable")
    fooled = samples.fooled(threshold)[order]
    chosen: list[int] = []
    failures, passes = order[fooled], order[~fooled & ~samples.invalid[order]]
    share = min(len(failures), max(count // 2, count - len(passes)))
    for rows, wanted in ((failures, share), (passes, min(count - share, len(passes)))):
        chosen += rows[np.linspace(0, len(rows) - 1, wanted).round().astype(np.intp)].tolist()
    return [sample(samples, row) for row in chosen]


def usual_count(evaluations: int) -> int:
    """Say how many pictures an attack of so many evaluations draws beside those of its sheet."""
    return min(_MOST_DRAWN, evaluations // _SHARE)
