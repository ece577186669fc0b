"""Draw the landing page's videos, docs/images/failure-*.gif: `python -m tools.draw_gifs [NAME]`.

Each is a sample of an attack, replayed as `sada-gym replay` does it. It takes about ten minutes.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym import Run, attack, make_application
from sada_gym.analyses.replay import replay

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
    """

    track: str
    adversary: str
    budget: int
    samples: int
    liking: Callable[[dict[str, Any]], float]
    ending: str = ""


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
    "quadrotor": Video("SADA-Quadrotor-Crazyflie-v0", "level-set", 400, 40, crashes_after),
    "go2": Video("SADA-Go2-Walk-v0", "level-set", 200, 30, falls_late),
    "metadrive": Video("SADA-DrivingMetaDrive-v0", "random", 0, 24, crashes_late),
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
    made = replay(result.folder, sample=row, out=IMAGES / f"failure-{name}.gif", seconds=SECONDS)
    assert made.size <= MOST_BYTES, made.size
    said = "; ".join(made.samples[0].endings)
    print(f"{made.path}: {said}; {made.seconds:.1f} s, {made.size / 1e6:.2f} MB")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as runs:
        for each in sys.argv[1:] or VIDEOS:
            draw(each, Path(runs))
