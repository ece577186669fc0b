"""Draw the landing page's videos, docs/images/failure-*.gif: `python -m tools.draw_gifs [NAME]`.

Each is a sample of an attack, replayed as `sada-gym replay` does it. It takes about ten minutes.
Videos that stand side by side show the scene alone, for their letters would be too small to read.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from sada_gym import Run, attack, make_application
from sada_gym.analyses.replay import replay
from sada_gym.analyses.replay.captions import FAILED, HOLD_S
from sada_gym.analyses.replay.gif import gif
from sada_gym.foundations.frames import Frame

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SECONDS = 4.4
MOST_BYTES = 2_000_000
WORKERS = 2


@dataclass(frozen=True)
class Video:
    """A video of the landing page.

    Attributes:
        track: What is attacked.
        adversary: By what.
        budget: The training queries.
        samples: The test samples.
        liking: How well a sample that fools suits the video, by its info.
        ending: What its ending must say, so that a person sees the failure.
        scene: The part of a frame that it shows (left, top, right, bottom); None shows all.
    """

    track: str
    adversary: str
    budget: int
    samples: int
    liking: Callable[[dict[str, Any]], float]
    ending: str = ""
    scene: tuple[int, int, int, int] | None = None


def wrongly_sure(info: dict[str, Any]) -> float:
    """Return how sure the detector is of another class; a pickup loses 1, as people may agree."""
    best = info["detections"][0] if info["detections"] else {"score": 0.0}
    return best["score"] - info["score"] - ("pickup" in info["shape"])


def rainy(info: dict[str, Any]) -> float:
    """Prefer rain, and among such worlds those in which drives go wrong late."""
    return 10.0 * ("Rain" in info["weather"]) + float(info["progress"].mean())


def hits_late(info: dict[str, Any]) -> float:
    """Prefer a frame that is hit after some gates were passed."""
    endings = info["endings"]
    return min(next((i for i, one in enumerate(endings) if one == "hit"), 0), 3)


def crashes_after(info: dict[str, Any]) -> float:
    """Prefer a quadrotor that crashes, and late."""
    return 10.0 * (info["ending"] == "crashed") + float(info["flown_s"])


def falls_late(info: dict[str, Any]) -> float:
    """Prefer a robot dog that falls, and after much of its way."""
    return 10.0 * (info["ending"] == "fell") + float(info["done"])


def crashes_late(info: dict[str, Any]) -> float:
    """Prefer a drive that ends at another car after much of its route."""
    return 10.0 * (info["ending"] == "hit_car") + float(info["route_done"])


VIDEOS = {
    "quadrotor": Video(
        "SADA-Quadrotor-Crazyflie-v0", "level-set", 400, 40, crashes_after, scene=(46, 12, 594, 310)
    ),
    "go2": Video("SADA-Go2-Walk-v0", "level-set", 200, 30, falls_late, scene=(46, 0, 594, 298)),
    "metadrive": Video(
        "SADA-DrivingMetaDrive-v0", "random", 0, 24, crashes_late, scene=(19, 4, 621, 331)
    ),
    "driving": Video("SADA-Driving-Navigation-v0", "cross-entropy", 60, 20, rainy, "on the right"),
    "racing": Video("SADA-UAV-4Anchors-v0", "bbgan", 500, 60, hits_late),
    "detection": Video("SADA-Detection-Car-v0", "bbgan", 2_000, 120, wrongly_sure),
}


def chosen(video: Video, result: Run) -> int:
    """Choose the sample that suits best, of those whose video ends as it should."""
    application, samples = make_application(video.track), result.samples
    infos = application.evaluate(samples.mu, samples.seed.tolist()).infos
    rows = [row for row, info in enumerate(infos) if info["fooled"]]
    rows.sort(key=lambda row: -video.liking(infos[row]))
    for row in rows if video.ending else ():
        (played,) = replay(result.folder, sample=row, seconds=1, application=application).samples
        if video.ending in played.endings[0]:
            return row
    return rows[0]


def only_scene(frame: Frame, time_s: float, box: tuple[int, int, int, int]) -> Frame:
    """Cut a frame to its scene; an ending keeps its coloured edge."""
    picture = Image.fromarray(frame).crop(box)
    if time_s == HOLD_S:
        edge = (0, 0, picture.width - 1, picture.height - 1)
        ImageDraw.Draw(picture).rectangle(edge, outline=FAILED, width=6)
    return np.asarray(picture)


def draw(name: str, folder: Path) -> None:
    """Attack, choose a sample, and write its video."""
    video = VIDEOS[name]
    result = attack(
        video.track,
        video.adversary,
        out=folder / name,
        budget=video.budget,
        samples=video.samples,
        seed=0,
        workers=WORKERS,
        pictures=False,
        resume=True,
    )
    row = chosen(video, result)
    made = replay(result.folder, sample=row, seconds=SECONDS)
    frames: Sequence[Frame] = made.frames
    if box := video.scene:
        frames = [only_scene(*each, box) for each in zip(frames, made.times_s, strict=True)]
    content = gif(frames, made.times_s, MOST_BYTES)
    assert len(content) <= MOST_BYTES, len(content)
    path = IMAGES / f"failure-{name}.gif"
    path.write_bytes(content)
    said = "; ".join(made.samples[0].endings)
    print(f"{path}: {said}; {made.seconds:.1f} s, {len(content) / 1e6:.2f} MB")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as runs:
        for each in sys.argv[1:] or VIDEOS:
            draw(each, Path(runs))
