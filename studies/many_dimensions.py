"""Adversaries in 10, 20 and 40 dimensions: queries to a coverage of 90 %, time and memory.

    python -m studies.many_dimensions run                    # goes on where it stopped
    python -m studies.many_dimensions tables

Each run is a line in `docs/results/many-dimensions/PROBLEM.jsonl`: AFR of 250 samples and their
coverage over that of as many ideal samples, F1 of both as on the leaderboard, their spread (their
standard deviation over that of all failures), seconds without those of the worlds, and by how many
MiB the process grew. Spread matters, because coverage forgives much in many dimensions: ideal
samples that are shrunk to half their spread cover all failures.

Of `corner-D` a corner of three parameters fails and the others do nothing; of `sum-D` the sum of
all; of `gust-D` the greatest mean of a fifth of neighbouring parameters, as of a curve. A tenth to
a fifth of uniform worlds fails. `cart-pole-D` is a pole in a wind with D knots over 100 steps;
`quadrotor-20`, `robot-20` and `go2-20` are the agents of `studies.stress`, disturbed by two curves
of ten knots.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import GymnasiumApplication, adversaries
from sada_gym.board.results.figures import f1
from sada_gym.envs.wrapped import Attribute
from sada_gym.errors import AdversaryError
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.arrays import Floats
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.parameters import Mu
from studies import stress
from studies.kept_rows import add_row, mean_f1, read_rows

BUDGETS, SAMPLES, DENSE = (250, 500, 1_000, 2_000), 250, 4_000
FOLDER = Path("docs/results/many-dimensions")
ADVERSARIES = (
    "level-set",
    "trees",
    "gp",
    "svm",
    "gmm50",
    "bbgan",
    "bbgan-boost",
    "smc",
    "cross-entropy",
    "cma-mae",
    "random",
)
FEWER = ("level-set", "trees", "gp", "random")
"""Those that are tried where worlds are slow, with 500 queries."""

Score = Callable[[Mu], Floats]


def corner(mu: Mu) -> Floats:
    """Return how far the worst of three parameters is below 0.05, which fails: (1.05/2)^3."""
    return np.clip(0.5 - 0.5 * (mu[:, :3] + 0.05).min(axis=1), 0.0, 1.0)


def total(mu: Mu) -> Floats:
    z = mu.sum(axis=1) / np.sqrt(mu.shape[1] / 3.0)
    return np.clip(0.5 - 0.25 * (z - 1.15), 0.0, 1.0)


def gust(mu: Mu) -> Floats:
    width = mu.shape[1] // 5
    window = np.lib.stride_tricks.sliding_window_view(mu, width, axis=1).mean(axis=2)
    limit = {2: 0.82, 4: 0.68, 8: 0.52}[width]
    return np.clip(0.5 - 0.5 * (window.max(axis=1) - limit), 0.0, 1.0)


def cart_pole(knots: int) -> GymnasiumApplication:
    strongest = {10: 0.125, 20: 0.16, 40: 0.21}[knots]
    return stress.pole(Attribute(-strongest, strongest, knots=knots, over=100))


def shipped(name: str) -> GymnasiumApplication:
    """Return an agent of `studies.stress` that two curves of ten knots disturb."""
    spread = {"quadrotor": 0.14, "robot": 0.55, "go2": 0.07}[name]
    return stress.shipped(name, Attribute(-spread, spread, knots=10, over=stress.SHIPPED[name][2]))


class Problem:
    """A problem, and a dense sample of it.

    Attributes:
        score: Q of mu, (n, d).
        fooling_set: Half of the dense sample's points that fool, (m, d); `ideal` is the other half.
    """

    def __init__(self, name: str) -> None:
        kind, _, number = name.rpartition("-")
        self.name, self.dimension, self.is_slow = name, int(number), kind in stress.SYSTEMS
        functions = {"corner": corner, "sum": total, "gust": gust}
        if kind in functions:
            self.score: Score = functions[kind]
            self.threshold, dense = 0.5, 10 * DENSE
        else:
            is_cart_pole = kind == "cart-pole"
            application = cart_pole(self.dimension) if is_cart_pole else shipped(kind)
            self.is_slow = not is_cart_pole
            self.threshold = application.fooling_threshold
            self.score = lambda mu: application.evaluate(mu, [0] * len(mu)).score
            dense = DENSE if is_cart_pole else 1_000
        rng = np.random.default_rng(2020)
        mu = rng.uniform(-1.0, 1.0, (dense, self.dimension)).astype(np.float32)
        kept = FOLDER / f"{name}.npz"
        if self.is_slow and kept.exists():
            fooled = np.load(kept)["fooled"]
        else:
            parts = np.array_split(mu, max(dense // 250, 1))
            fooled = np.concatenate([self.score(part) for part in parts]) <= self.threshold
            if self.is_slow:
                np.savez_compressed(kept, fooled=fooled)
        self.rate = float(fooled.mean())
        inside = mu[fooled][:2_000]
        self.fooling_set, self.ideal = inside[::2], inside[1::2]

    def run(self, adversary: str, budget: int, seed: int) -> dict[str, Any]:
        """Train an adversary and measure it; `error` alone where it cannot be trained."""
        row: dict[str, Any] = {"adversary": adversary, "budget": budget, "seed": seed}
        in_worlds = [0.0]

        def timed(mu: Mu) -> Floats:
            start = time.process_time()
            scores = self.score(mu)
            in_worlds[0] += time.process_time() - start
            return scores

        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        solver = adversaries.make(adversary, dimension=self.dimension, seed=seed)
        given = {"dimension": self.dimension, "threshold": self.threshold, "seed": seed}
        try:
            with Oracle(timed, budget=budget, **given) as oracle:
                solver.train(oracle)
            mu = solver.sample(SAMPLES)
        except AdversaryError as error:
            return row | {"error": str(error)}
        spent = time.process_time() - start - in_worlds[0]
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1_024
        fooled = self.score(mu) <= self.threshold
        covered = fooling_coverage(mu, fooled, self.fooling_set, seed=seed).coverage
        rng = np.random.default_rng([seed, 7])
        ideal = self.ideal[
            rng.choice(len(self.ideal), min(SAMPLES, len(self.ideal)), replace=False)
        ]
        whole = fooling_coverage(
            ideal, np.ones(len(ideal), np.bool_), self.fooling_set, seed=seed
        ).coverage
        relative = min(covered / whole, 1.0)
        afr = float(fooled.mean())
        return row | {
            "afr": afr,
            "coverage": relative,
            "f1": float(f1(afr, relative)),
            "spread": float((mu.std(axis=0) / self.fooling_set.std(axis=0)).mean()),
            "seconds": round(spent, 1),
            "mib": round(grown),
        }


KINDS, DIMENSIONS = ("corner", "sum", "gust", "cart-pole"), (10, 20, 40)
BY_DIMENSION = {d: [f"{kind}-{d}" for kind in KINDS] for d in DIMENSIONS}
AGENTS = ["robot-20", "go2-20", "quadrotor-20"]
PROBLEMS = (*(name for names in BY_DIMENSION.values() for name in names), *AGENTS)


def read(problem: str) -> list[dict[str, Any]]:
    return read_rows(FOLDER / f"{problem}.jsonl")


def means(problem: str) -> dict[str, dict[int, float]]:
    return mean_f1(read(problem))


def _in_process(problem: Problem, job: tuple[str, int, int], queue: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        queue.put(problem.run(*job))


def measure(name: str, seeds: list[int], names: Sequence[str]) -> None:
    """Run what is missing, each in a process of its own, and write each run as it comes."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    problem = Problem(name)
    print(f"{name}: {problem.rate:.3f} of uniform worlds fail, {len(problem.fooling_set)} points")
    done = {(row["adversary"], row["budget"], row["seed"]) for row in read(name)}
    context = multiprocessing.get_context("fork")
    for seed in seeds:
        for adversary in FEWER if problem.is_slow else names:
            for budget in BUDGETS[1:2] if problem.is_slow else BUDGETS:
                if (job := (adversary, budget, seed)) in done:
                    continue
                queue = context.Queue()
                process = context.Process(target=_in_process, args=(problem, job, queue))
                process.start()
                row = queue.get(timeout=3_600)
                process.join()
                add_row(FOLDER / f"{name}.jsonl", row)


def _cell(rows: list[dict[str, Any]]) -> str:
    """Say how many queries gave a coverage of 90 %, and F1 with most queries."""
    if not rows:
        return ""
    reached = [row["budget"] for row in rows if row["coverage"] >= 0.9]
    most = max(rows, key=lambda row: row["budget"])
    return f"{min(reached):,} / {most['f1']:.2f}" if reached else f"- / {most['f1']:.2f}"


def tables() -> str:
    """Write the spread on gust-20, a table for each dimension, and one of the agents; seed 0."""
    lines = ["| adversary | " + " | ".join(f"{budget:,} queries" for budget in BUDGETS) + " |"]
    lines.append("| --- " * (len(BUDGETS) + 1) + "|")
    for adversary in ADVERSARIES:
        spreads = {
            row["budget"]: row["spread"]
            for row in read("gust-20")
            if row["adversary"] == adversary and "spread" in row
        }
        if spreads:
            shown = " | ".join(f"{spreads[budget]:.2f}" for budget in BUDGETS)
            lines.append(f"| `{adversary}` | {shown} |")
    lines.append("")
    for problems in (*BY_DIMENSION.values(), AGENTS):
        rows_of = {
            one: [row for row in read(one) if "f1" in row and not row["seed"]] for one in problems
        }
        measured = [one for one in problems if rows_of[one]]
        if not measured:
            continue
        lines += ["| adversary | " + " | ".join(measured) + " | seconds | MiB |"]
        lines += ["| --- " * (len(measured) + 3) + "|"]
        for adversary in ADVERSARIES:
            of = {
                one: [row for row in rows_of[one] if row["adversary"] == adversary]
                for one in measured
            }
            last = [max(rows, key=lambda row: row["budget"]) for rows in of.values() if rows]
            if last:
                cells = [_cell(rows) for rows in of.values()]
                cells.append(f"{np.mean([row['seconds'] for row in last]):.0f}")
                cells.append(f"{np.mean([row['mib'] for row in last]):.0f}")
                lines.append(f"| `{adversary}` | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def shrunk(name: str) -> str:
    """Say how much 250 ideal samples cover when they shrink towards their mean."""
    problem = Problem(name)
    ideal = problem.ideal[:SAMPLES]
    middle = ideal.mean(axis=0)
    said = []
    for spread in (1.0, 0.7, 0.5):
        mu = middle + spread * (ideal - middle)
        found = fooling_coverage(mu, np.ones(len(mu), np.bool_), problem.fooling_set)
        said.append(f"{spread}: {found.coverage:.2f}")
    return f"{name}: coverage by spread {', '.join(said)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("action", choices=("run", "tables", "shrunk"))
    parser.add_argument("problems", nargs="*", default=PROBLEMS)
    parser.add_argument("--adversaries", nargs="+", default=ADVERSARIES)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    given = parser.parse_args()
    if given.action == "tables":
        print(tables())
        return
    for problem in given.problems:
        if given.action == "shrunk":
            print(shrunk(problem))
            continue
        measure(problem, given.seeds, given.adversaries)


if __name__ == "__main__":
    main()
