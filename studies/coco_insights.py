"""What decides whether the COCO detector is fooled: Sobol indices, and shares by bands.

    python -m studies.coco_insights --queries 2000 --out runs/coco-insights

A forest is fitted to the scores of uniform worlds of each track; the total Sobol index of a
parameter is taken from the forest's predictions by Saltelli's design. Next to it stands how well
the forest predicts worlds that it was not fitted to. The shares of worlds that fool are counted in
the uniform worlds themselves. OUT gets a store a track, so that a second call goes on, and the
tables as JSON and Markdown.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import sobol_indices, uniform
from sklearn.ensemble import RandomForestRegressor

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.scene import Scene, direction
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.files import write_file
from sada_gym.measures.rates import wilson_interval
from sada_gym.oracle import Oracle

ROWS = 4_096
PITCH_DEG = (0, 10, 20, 30, 40, 51.6)
LIGHT_AZIMUTH_DEG = (0, 45, 90, 135, 180)
LIGHT_PITCH_DEG = (0, 20, 40, 60, 90)
MIRRORED_DEG = (0, 20, 40, 80, 180)
CONTRAST = (0, 0.3, 0.5, 0.7, 2)


def uniform_worlds(track: str, queries: int, out: Path) -> tuple[DetectionApplication, Evaluations]:
    """Evaluate uniform worlds of a track; those in its store are not evaluated again."""
    with Oracle(track, budget=queries, seed=0, store=out / f"{track}.sqlite") as oracle:
        rng = np.random.default_rng(0)
        oracle(rng.uniform(-1.0, 1.0, (queries, oracle.dimension)))
        application = oracle.application
        assert isinstance(application, DetectionApplication)
        return application, oracle.record


def total_indices(worlds: Evaluations) -> tuple[Floats, float]:
    """Return the total Sobol index of each parameter, (d,), and the forest's R2 out of bag."""
    forest = RandomForestRegressor(
        400, min_samples_leaf=2, max_features=0.7, oob_score=True, random_state=0
    )
    forest.fit(worlds.mu, worlds.score)
    found = sobol_indices(
        func=lambda x: forest.predict(x.T)[None],
        n=ROWS,
        dists=[uniform(-1.0, 2.0)] * worlds.mu.shape[1],
        rng=np.random.default_rng(0),
    )
    return np.asarray(found.total_order).reshape(-1), float(forest.oob_score_)


def features(scenes: Sequence[Scene]) -> dict[str, tuple[Floats, Sequence[float]]]:
    """Return by name what worlds are sorted by, (n,), and the borders of its bands."""
    pitch = np.array([scene.camera_pitch_deg for scene in scenes])
    azimuth = np.abs([scene.light_azimuth_deg for scene in scenes])
    height = np.array([scene.light_pitch_deg for scene in scenes])
    return {
        "camera pitch": (pitch, PITCH_DEG),
        "light's angle from the camera": (azimuth, LIGHT_AZIMUTH_DEG),
        "light pitch": (height, LIGHT_PITCH_DEG),
        "camera's angle to the light mirrored in a roof": (
            np.array([mirrored_deg(scene) for scene in scenes]),
            MIRRORED_DEG,
        ),
        "paint's distance to the ground's colour": (
            np.array([contrast(scene) for scene in scenes]),
            CONTRAST,
        ),
    }


def mirrored_deg(scene: Scene) -> float:
    """Return the angle between the camera and where a level surface mirrors the light to."""
    camera = direction(scene.camera_azimuth_deg, scene.camera_pitch_deg)
    light = direction(scene.camera_azimuth_deg + scene.light_azimuth_deg, scene.light_pitch_deg)
    mirrored = light * np.array([-1.0, -1.0, 1.0])
    return math.degrees(math.acos(float(np.clip(camera @ mirrored, -1.0, 1.0))))


def contrast(scene: Scene) -> float:
    """Return the distance of the paint from the ground's colour, both sRGB."""
    ground = np.asarray(scene.backdrop.ground_colour) ** (1 / 2.2)
    return float(np.linalg.norm(np.asarray(scene.colour) - ground))


def shares(
    values: Floats, borders: Sequence[float], fooled: Bools
) -> Iterator[tuple[str, int, int]]:
    """Yield each band, how many worlds in it fool, and how many lie in it."""
    for low, high in pairwise(borders):
        inside = (values >= low) & ((values < high) | (high == borders[-1]))
        yield f"{low:g} to {high:g}", int(fooled[inside].sum()), int(inside.sum())


def insights(track: str, queries: int, out: Path) -> dict:
    """Measure one track."""
    application, worlds = uniform_worlds(track, queries, out)
    total, fit = total_indices(worlds)
    fooled = worlds.fooled(application.fooling_threshold)
    seeds = worlds.seed.tolist()
    scenes = [application.scene(mu, seed) for mu, seed in zip(worlds.mu, seeds, strict=True)]
    names = application.parameters.names
    bands = {
        name: list(shares(values, borders, fooled))
        for name, (values, borders) in features(scenes).items()
        if "paint" not in name or "colour_red" in names
    }
    return {
        "track": track,
        "queries": queries,
        "fooled": int(fooled.sum()),
        "r2": fit,
        "total": dict(zip(names, total.tolist(), strict=True)),
        "bands": bands,
    }


def tables(rows: Sequence[dict]) -> Iterator[str]:
    """Yield the tables as Markdown."""
    names = list(dict.fromkeys(name for row in rows for name in row["total"]))
    yield f"| track | fooled | forest's R2 | {' | '.join(names)} |"
    yield "| --- " * (3 + len(names)) + "|"
    for row in rows:
        cells = (f"{row['total'][name]:.2f}" if name in row["total"] else "-" for name in names)
        rate = _percent(row["fooled"], row["queries"])
        yield f"| {row['track']} | {rate} | {row['r2']:.2f} | {' | '.join(cells)} |"
    for name in dict.fromkeys(name for row in rows for name in row["bands"]):
        with_it = [row for row in rows if name in row["bands"]]
        yield ""
        yield f"| {name} | {' | '.join(row['track'] for row in with_it)} |"
        yield "| --- " * (1 + len(with_it)) + "|"
        for i, (band, *_) in enumerate(with_it[0]["bands"][name]):
            cells = (_percent(*row["bands"][name][i][1:]) for row in with_it)
            yield f"| {band} | {' | '.join(cells)} |"


def _percent(part: int, whole: int) -> str:
    if not whole:
        return "-"
    low, high = wilson_interval(part, whole)
    return f"{100 * part / whole:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def main(arguments: Sequence[str] | None = None) -> None:
    card = find_card("SADA-DetectionCoco")
    assert card is not None
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", nargs="*", default=list(card.track_ids))
    parser.add_argument("--queries", type=int, default=2_000)
    parser.add_argument("--out", type=Path, default=Path("runs/coco-insights"))
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for track in given.tracks:
        rows.append(insights(track, given.queries, given.out))
        print(f"{track}: {rows[-1]['total']}", flush=True)
    text = "\n".join(tables(rows))
    write_file(given.out / "insights.json", json.dumps(rows, indent=2).encode())
    write_file(given.out / "insights.md", f"{text}\n".encode())
    print(text)


if __name__ == "__main__":
    main()
