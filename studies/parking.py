"""INDAGO's parking: searches by others and this package's adversaries, at equal queries.

    python -m studies.parking --out runs/parking

It does what is missing and prints the table; `--table` prints what is there. Each search plays
BUDGET worlds. INDAGO and INDAGO-Nexus also know the log of the agent's training; the others do not.
An adversary of this package learns from the first three fifths of its worlds, and draws the others
as samples; all of them count. OUT/SEARCH-SEED.json is written as each run is done.

Unique failures are counted as in INDAGO: the failures of all searches with the same seed are
clustered together by k-means on INDAGO's 24 features, with the number of clusters that has the
highest silhouette, and a search has as many unique failures as there are clusters that it reaches.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_score

from sada_gym import GymnasiumApplication, adversaries
from sada_gym.envs.wrapped import ResetOption
from sada_gym.foundations.determinism import one_thread
from sada_gym.foundations.files import write_file
from studies.agents import FOLDER, checked
from studies.means import mean_text
from studies.parking_searches import Ask, Bools, Floats, TrainingLog, indago, nexus
from studies.training.parking.world import HALF_X_M, HALF_Y_M, OTHERS, SLOTS, ParkingWorld, World
from studies.without_hits import without_hits

AGENT = FOLDER / "parking.zip"
SHA256 = "f8da99002d464e0380f37b9e06ba2b159274047c836bef46f1f0323778ff93af"
LOG = FOLDER / "parking-log.npz"

BUDGET, LEARNT = 100, 0.6
SEEDS = (0, 1, 2, 3, 4)
OURS = ("random", "level-set", "gp", "bbgan")
MOST_CLUSTERS = 30

PARAMETERS = {
    "goal": ResetOption(0, SLOTS - 1, integer=True),
    "heading": ResetOption(0.0, 1.0, unit="turns"),
    "x": ResetOption(-HALF_X_M, HALF_X_M, unit="m"),
    "y": ResetOption(-HALF_Y_M, HALF_Y_M, unit="m"),
    **{name: ResetOption(choices=("free", "parked")) for name in OTHERS},
}
"""A search's 23 dimensions. The parked cars are counted from the goal, so that every mu is a world
of the papers, every such world is a mu, and the slots beside the goal are always the same ones."""


def parking(agent: Any = None) -> GymnasiumApplication:
    """Return the application; the agent fails if it crashes or is late, as in the papers."""
    if agent is None:
        agent = checked(AGENT, SHA256)
    return GymnasiumApplication(
        ParkingWorld,
        agent=agent,
        parameters=PARAMETERS,
        score="success",
        fooling_threshold=0.5,
        max_steps="own",
        name="Parking",
    )


def worlds_of(mu: npt.ArrayLike, application: GymnasiumApplication) -> list[World]:
    """Return the worlds of mu, (n, 23)."""
    return [
        World.from_options(
            {
                name: binding.value(float(value))
                for (name, binding), value in zip(PARAMETERS.items(), row, strict=True)
            }
        )
        for row in application.parameters.physical(mu)
    ]


def mu_of(worlds: Sequence[World], application: GymnasiumApplication) -> npt.NDArray[np.float32]:
    """Return the mu, (n, 23), of worlds: the middle of the cell where a parameter is a choice."""
    physical = [
        [
            {"free": 0.5, "parked": 1.5}[value] if name in OTHERS else float(value)
            for name, value in world.options.items()
        ]
        for world in worlds
    ]
    mu: npt.NDArray[np.float32] = application.parameters.normalised(np.array(physical))
    return mu


class Play:
    """Plays the worlds of a search, and keeps them.

    Args:
        application: The agent and its worlds.
        budget: How many worlds may be played.
    """

    threshold = 0.5

    def __init__(self, application: GymnasiumApplication, budget: int) -> None:
        self._application, self.permits = application, application.permits
        self.remaining = budget
        self.worlds: list[World] = []
        self.failed: list[bool] = []

    def __call__(self, mu: npt.ArrayLike) -> Floats:
        """Score mu, (n, 23): 0 where the agent fails, else 1."""
        points = np.asarray(mu, np.float32)
        if len(points) > self.remaining:
            raise ValueError(f"Expected at most {self.remaining} worlds, got {len(points)}.")
        outcomes = self._application.evaluate(points, [0] * len(points))
        self.remaining -= len(points)
        self.worlds += worlds_of(points, self._application)
        self.failed += outcomes.fooled.tolist()
        return outcomes.score

    def ask(self, features: Floats) -> Bools:
        """Play INDAGO's features, (n, 24), and say in which the agent failed, (n,)."""
        worlds = [World.from_features(row) for row in features]
        return self(mu_of(worlds, self._application)) <= self.threshold


def adversary(play: Play, seed: int, *, name: str) -> None:
    """Let one of this package's adversaries learn, and play its samples with what is left."""
    found = adversaries.make(name, len(PARAMETERS), seed=seed, **without_hits(name))
    budget = play.remaining
    held = budget - int(LEARNT * budget)
    play.remaining -= held
    found.train(play)
    play.remaining += held
    play(found.sample(play.remaining))


def by_log(play: Play, seed: int, *, search: Callable[[Ask, int, TrainingLog, int], None]) -> None:
    """Let a search play that knows the log of the agent's training."""
    with np.load(LOG) as log:
        search(
            play.ask,
            play.remaining,
            TrainingLog(log["features"].astype(np.float64), log["failed"]),
            seed,
        )


SEARCHES: Mapping[str, Callable[[Play, int], None]] = {
    "INDAGO": partial(by_log, search=indago),
    "INDAGO-Nexus": partial(by_log, search=nexus),
    **{name: partial(adversary, name=name) for name in OURS},
}


def run(application: GymnasiumApplication, search: str, seed: int, budget: int) -> dict[str, Any]:
    """Run a search; give what it played as data for JSON."""
    play = Play(application, budget)
    started = time.process_time()
    with one_thread():
        SEARCHES[search](play, seed)
    failures = [
        np.round(world.features, 4).tolist()
        for world, failed in zip(play.worlds, play.failed, strict=True)
        if failed
    ]
    return {
        "search": search,
        "seed": seed,
        "agent": SHA256,
        "budget": len(play.failed),
        "failed": [int(failed) for failed in play.failed],
        "failures": failures,
        "seconds": round(time.process_time() - started, 1),
    }


def unique_failures(failures: Mapping[str, Sequence[Sequence[float]]], seed: int) -> dict[str, int]:
    """Return how many clusters of all failures each search reaches.

    Args:
        failures: The features of each search's failures, (n, 24).
        seed: Fixes k-means.
    """
    names = [name for name, rows in failures.items() for _ in rows]
    points = np.array([row for rows in failures.values() for row in rows])
    labels = np.zeros(len(names), int)
    best = -1.0
    for count in range(2, min(len(np.unique(points, axis=0)), MOST_CLUSTERS + 1)):
        found = KMeans(count, random_state=seed, n_init=1).fit_predict(points)
        score = silhouette_score(points, found)
        if score > best:
            best, labels = score, found
    reached: dict[str, set[int]] = {name: set() for name in failures}
    for name, label in zip(names, labels.tolist(), strict=True):
        reached[name].add(label)
    return {name: len(clusters) for name, clusters in reached.items()}


def first_failure(failed: Sequence[int]) -> int:
    """Return the number of the first world in which the agent failed; one more than all if none."""
    return failed.index(1) + 1 if 1 in failed else len(failed) + 1


def table(out: Path) -> str:
    """Return the table of all runs in a folder, in Markdown."""
    pieces = [json.loads(path.read_text("utf-8")) for path in sorted(out.glob("*-*.json"))]
    unique: dict[str, list[int]] = {name: [] for name in SEARCHES}
    for seed in sorted({piece["seed"] for piece in pieces}):
        failures = {p["search"]: p["failures"] for p in pieces if p["seed"] == seed}
        for name, count in unique_failures(failures, seed).items():
            unique[name].append(count)
    lines = [
        "| search | knows the training log | failures | unique failures | first failure after | "
        "seconds of one core |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in SEARCHES:
        runs = [piece for piece in pieces if piece["search"] == name]
        if runs:
            knows = "no" if name in OURS else "yes"
            cells = [
                mean_text([sum(one["failed"]) for one in runs], 1),
                mean_text(unique[name], 1),
                mean_text([first_failure(one["failed"]) for one in runs], 1),
                f"{np.mean([one['seconds'] for one in runs]):.0f}",
            ]
            lines.append(f"| {name} | {knows} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/parking"))
    parser.add_argument("--table", action="store_true", help="print what is there")
    parser.add_argument("--budget", type=int, default=BUDGET)
    parser.add_argument("--searches", nargs="+", choices=list(SEARCHES), default=list(SEARCHES))
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    if not given.table:
        application = parking()
        for seed in SEEDS:
            for search in given.searches:
                file = given.out / f"{search}-{seed}.json"
                if not file.exists():
                    piece = run(application, search, seed, given.budget)
                    write_file(file, (json.dumps(piece) + "\n").encode())
                    print(f"{file.name}: {sum(piece['failed'])} failures", flush=True)
    print(table(given.out))


if __name__ == "__main__":
    main()
