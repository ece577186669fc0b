"""RRLS' sets for the hopper: how low a return does each search find, beside the grid of RRLS?

    python -m studies.worst_return --out runs/worst-return

It does what is missing and prints the table; `--table` prints what is there. The sets are those of
Zouitine et al. (2024), of one to three parameters. RRLS plays every world of a grid of ten values a
parameter. Each search plays as many worlds, and a tenth as many where that is ten or more. Its
answer is the world in which the agent had the lowest return in one episode. The mean return of 30
other episodes there is what counts, because the lowest of many noisy returns would flatter whoever
asks most. OUT/SEARCH-PARAMETERS-WORLDS-SEED.json is written as each is done.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import GymnasiumApplication, adversaries
from sada_gym.adversaries.level_set import MIN_BUDGET
from sada_gym.envs.wrapped import Attribute
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.determinism import one_thread
from sada_gym.foundations.files import write_file
from studies.agents import FOLDER, checked
from studies.means import mean_text
from studies.training.hopper import ENVIRONMENT
from studies.without_hits import without_hits

AGENT = FOLDER / "hopper.zip"
SHA256 = "29f3bfe7f071a4c0883fdae71cd2cad4b3397db2347f4d9ddde47b916d103aa9"

PARAMETERS = {
    "friction": Attribute(0.1, 3.0, paths="model.geom_friction[0,0]"),
    "torso_mass": Attribute(0.1, 3.0, paths="model.body_mass[1]", unit="kg"),
    "thigh_mass": Attribute(0.1, 4.0, paths="model.body_mass[2]", unit="kg"),
}
"""The set of d parameters holds the first d."""

VALUES = 10
"""The grid's values of each parameter, as in RRLS from its lower end on: its upper end is none."""
SEEDS = (0, 1, 2, 3, 4)
SEARCHES = ("random", "level-set", "bayesian", "cma-mae")
LEAST_WORLDS = {"level-set": MIN_BUDGET}
"""A search that takes no fewer; others take ten."""
EPISODES = 30
HIGHEST_RETURN = 4_000.0


def hopper(parameters: int, agent: Any = None) -> GymnasiumApplication:
    """Return the application with the set of so many parameters; its score is the return."""
    return GymnasiumApplication(
        ENVIRONMENT,
        agent=checked(AGENT, SHA256) if agent is None else agent,
        parameters=dict(list(PARAMETERS.items())[:parameters]),
        score=("return", 0.0, HIGHEST_RETURN),
        fooling_threshold=0.0,  # the lowest return is unknown, so that no world is low enough
        name="Hopper",
    )


def grid(parameters: int) -> npt.NDArray[np.float32]:
    """Return mu of RRLS' grid, (10^d, d)."""
    values = -1.0 + 2.0 * np.arange(VALUES) / VALUES
    axes = np.meshgrid(*[values] * parameters, indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1).astype(np.float32)


class Lowest:
    """Plays the worlds of a search, and keeps the one of the lowest return.

    Args:
        oracle: Scores mu, and knows how many may be scored.
    """

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle
        self.threshold, self.permits = oracle.threshold, oracle.permits
        self.mu: npt.NDArray[np.float32] | None = None
        self.score = np.inf

    @property
    def remaining(self) -> int:
        """How many worlds are left."""
        return self._oracle.remaining

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, (n, d): (n,)."""
        points = np.asarray(mu, np.float32)
        scores = self._oracle(points)
        lowest = int(np.argmin(scores))
        if scores[lowest] < self.score:
            self.mu, self.score = points[lowest], float(scores[lowest])
        return scores


def run(search: str, parameters: int, worlds: int, seed: int, agent: Any = None) -> dict[str, Any]:
    """Run a search; give its answer and the return there as data for JSON."""
    application = hopper(parameters, agent)
    started = time.process_time()
    with (
        one_thread(),
        Oracle(application, budget=worlds, seed=seed) as asked,
        Oracle(application, budget=EPISODES, seed=seed, stream="test") as judged,
    ):
        lowest = Lowest(asked)
        if search == "grid":
            lowest(grid(parameters))
        else:
            adversary = adversaries.make(search, parameters, seed=seed, **without_hits(search))
            adversary.train(lowest)
            if lowest.remaining:  # `random` asks nothing before it draws
                lowest(adversary.sample(lowest.remaining))
        assert lowest.mu is not None
        seconds = time.process_time() - started
        returns = HIGHEST_RETURN * judged(np.repeat(lowest.mu[None], EPISODES, axis=0))
    names = list(PARAMETERS)[:parameters]
    physical = application.parameters.physical(lowest.mu[None])[0]
    return {
        "search": search,
        "parameters": parameters,
        "worlds": worlds,
        "seed": seed,
        "agent": SHA256,
        "world": {
            name: round(float(value), 4) for name, value in zip(names, physical, strict=True)
        },
        "seen": round(HIGHEST_RETURN * lowest.score, 2),
        "return": round(float(returns.mean()), 2),
        "seconds": round(seconds, 1),
    }


def plan() -> Iterator[tuple[str, int, int, int]]:
    """Yield each run: search, number of parameters, worlds, seed."""
    for parameters in range(1, len(PARAMETERS) + 1):
        for seed in SEEDS:
            yield "grid", parameters, VALUES**parameters, seed
            for worlds in (VALUES**parameters, VALUES**parameters // 10):
                for search in SEARCHES:
                    if worlds >= LEAST_WORLDS.get(search, 10):
                        yield search, parameters, worlds, seed


def table(out: Path) -> str:
    """Return the table of all runs in a folder, in Markdown."""
    pieces = [json.loads(path.read_text("utf-8")) for path in sorted(out.glob("*.json"))]
    columns = sorted({(d, worlds) for _, d, worlds, _ in plan()}, key=lambda c: (c[0], -c[1]))
    lines = [
        f"| search | {' | '.join(f'd = {d}, {worlds:,} worlds' for d, worlds in columns)} |",
        "| --- " * (1 + len(columns)) + "|",
    ]
    for search in ("grid", *SEARCHES):
        cells = []
        for parameters, worlds in columns:
            found = [
                piece["return"]
                for piece in pieces
                if (piece["search"], piece["parameters"], piece["worlds"])
                == (search, parameters, worlds)
            ]
            cells.append(mean_text(found, 0) if found else "-")
        lines.append(f"| {search} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/worst-return"))
    parser.add_argument("--table", action="store_true", help="print what is there")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    for search, parameters, worlds, seed in () if given.table else plan():
        file = given.out / f"{search}-{parameters}-{worlds}-{seed}.json"
        if not file.exists():
            piece = run(search, parameters, worlds, seed)
            write_file(file, (json.dumps(piece) + "\n").encode())
            print(f"{file.name}: {piece['return']:.0f}, {piece['seconds']:.0f} s", flush=True)
    print(table(given.out))


if __name__ == "__main__":
    main()
