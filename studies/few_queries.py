"""Which adversary when a simulator is slow? All of them with 50 to 400 queries.

    python -m studies.few_queries run SADA-Digits-3-v0      # goes on where it stopped
    python -m studies.few_queries tables                    # Markdown, from all tracks

Settings of `level-set` are chosen on the tracks of CHOOSE; those of JUDGE are for the judgement.
Each run is a line in `docs/results/few-queries/TRACK.jsonl`: the AFR of 100 samples, their coverage
over that of as many ideal samples, F1 of both as on the leaderboard, and how many weaknesses of the
diagnosis are confirmed and how many of these are false: in the reference set, worlds inside such
a weakness fail no more often than those outside.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import adversaries
from sada_gym.analyses.diagnose import default_fresh
from sada_gym.board.results.figures import f1
from sada_gym.errors import AdversaryError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.diagnosis.core import diagnose_worlds
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.measures.reference import Reference, load_reference
from sada_gym.parameters import Mu
from studies.kept_rows import add_row, mean_f1, read_rows

CHOOSE = (
    "SADA-Detection-Car-v0",
    "SADA-Digits-3-v0",
    "SADA-UAV-3Anchors-v0",
    "SADA-Quadrotor-Crazyflie-v0",
    "SADA-Photos-Street-v0",
)
JUDGE = (
    "SADA-Driving-Straight-v0",
    "SADA-Robot-Warehouse-v0",
    "SADA-DetectionCoco-Car-v0",
    "SADA-Go2-Walk-v0",
    "SADA-Flight-C310-v0",
)
BUDGETS, SEEDS, SAMPLES = (50, 100, 200, 400), (0, 1, 2), 100
DIAGNOSED = ("bbgan", "trees", "level-set")
COLUMNS = ("random", "bbgan", "gp", "trees", "level-set")
ALL = "SADA-Digits-3-v0"
SHARES = 0.02
"""F1 that is at most so much below the best counts as shared: means of three seeds differ so."""
FOLDER = Path("docs/results/few-queries")


class Track:
    """A track with a reference set, and what is measured of samples on it."""

    def __init__(self, name: str, store: str | None = None) -> None:
        # many runs ask for the same worlds: a store answers them after the first
        self.name, self.evaluator = name, Evaluator(name, workers=1, store=store)
        application = self.evaluator.application
        reference = load_reference(name, application)
        assert reference is not None, f"{name} has no reference set"
        self.space, self.threshold = application.parameters, application.fooling_threshold
        self.reference: Reference = reference
        self.fooling_set, self._ideal = reference.split()
        # ideal samples fool as often as the fooling set's points did on their seeds
        self.ideal_afr = float(reference.fooling_rate[reference.fooling].mean())
        self._fooled: dict[tuple[bytes, int, str], Bools] = {}

    def fooled(self, mu: Mu, seed: int, stream: str) -> Bools:
        """Return which worlds fool; `random` asks for the same ones at each budget."""
        key = (mu.tobytes(), seed, stream)
        if key not in self._fooled:
            self._fooled[key] = self._evaluate(mu, seed, stream)
        return self._fooled[key]

    def _evaluate(self, mu: Mu, seed: int, stream: str) -> Bools:
        with Oracle(self.evaluator, budget=len(mu), seed=seed, stream=stream) as oracle:  # type: ignore[arg-type]
            return np.asarray(oracle(mu) <= self.threshold)

    def ideal_coverage(self, seed: int) -> float:
        rng = np.random.default_rng([seed, 7])
        count = min(SAMPLES, len(self._ideal))
        drawn = self._ideal[rng.choice(len(self._ideal), count, replace=False)]
        fooled = rng.random(count) < self.ideal_afr
        return fooling_coverage(drawn, fooled, self.fooling_set, seed=seed).coverage

    def run(self, adversary: str, budget: int, seed: int, **options: Any) -> dict[str, Any]:
        """Train an adversary and measure it; `error` alone where the budget is too small."""
        start = time.monotonic()
        row: dict[str, Any] = {"adversary": adversary, "budget": budget, "seed": seed}
        solver = adversaries.make(adversary, dimension=len(self.space), seed=seed, **options)
        asked: list[tuple[Mu, Any]] = []
        with Oracle(self.evaluator, budget=budget, seed=seed) as oracle:

            class Watched:
                """Keeps the queries in their order."""

                threshold, permits = oracle.threshold, staticmethod(oracle.permits)

                @property
                def remaining(self) -> int:
                    return oracle.remaining

                def __call__(self, mu: Mu) -> Any:
                    score = oracle(mu)
                    asked.append((np.asarray(mu, np.float32), score))
                    return score

            try:
                solver.train(Watched())
                mu = solver.sample(SAMPLES)
            except AdversaryError as error:
                return row | {"error": str(error)}
        spent = time.monotonic() - start
        fooled = self.fooled(mu, seed, "test")
        afr = float(fooled.mean())
        coverage = fooling_coverage(mu, fooled, self.fooling_set, seed=seed).coverage
        relative = min(coverage / max(self.ideal_coverage(seed), 1e-9), 1.0)
        row |= {"afr": afr, "coverage": relative}
        row |= {"f1": float(f1(afr, relative, self.ideal_afr)), "seconds": round(spent, 2)}
        if adversary in DIAGNOSED:
            queries = Evaluations.unseeded(
                np.concatenate([part for part, _ in asked]),
                np.concatenate([score for _, score in asked]),
            )
            uniform = np.arange(budget + SAMPLES) < solver.uniform_part(budget)
            row |= self._weaknesses(queries, mu, fooled, uniform, seed)
        return row

    def _weaknesses(
        self, queries: Evaluations, samples: Mu, fooled: Bools, uniform: Bools, seed: int
    ) -> dict[str, int]:
        """Diagnose as `sada-gym attack` does, and count what the reference set denies."""
        scores = np.where(fooled, 0.0, 1.0)
        known = Evaluations.unseeded(
            np.concatenate([queries.mu, samples]),
            np.append(np.where(queries.fooled(self.threshold), 0.0, 1.0), scores),
        )
        given = [0]

        def evaluate(mu: Mu) -> tuple[Bools, Bools]:
            given[0] += 1
            result = self.fooled(mu, 1_000 * seed + given[0], "validation")
            return result, np.ones(len(mu), np.bool_)

        diagnosis = diagnose_worlds(
            self.space,
            known,
            0.5,
            uniform,
            evaluate=evaluate,
            fresh=default_fresh(len(queries)),
            enough=True,
            seed=seed,
        )
        named = [one for one in diagnosis.weaknesses if one.is_checked]
        false = 0
        for one in named:
            inside = holds(one.conditions, self.space, self.reference.mu.astype(np.float64))
            rate = self.reference.fooling_rate
            false += bool(inside.any()) and bool(rate[inside].mean() <= rate[~inside].mean())
        return {"named": len(named), "false": int(false)}


def read(track: str) -> list[dict[str, Any]]:
    return read_rows(FOLDER / f"{track}.jsonl")


def measure(
    track: str,
    names: Sequence[str],
    budgets: Sequence[int],
    seeds: Sequence[int],
    store: str | None = None,
) -> None:
    """Run what is missing of a track, and write each run as it comes."""
    done = {(row["adversary"], row["budget"], row["seed"]) for row in read(track)}
    opened = Track(track, store)
    for seed in seeds:
        for name in names:
            for budget in budgets:
                if (name, budget, seed) in done:
                    continue
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    row = opened.run(name, budget, seed)
                add_row(FOLDER / f"{track}.jsonl", row)


def means(track: str) -> dict[str, dict[int, float]]:
    return mean_f1(read(track))


def table(tracks: Sequence[str], names: Sequence[str]) -> list[str]:
    """Write F1 by track and budget, a column an adversary; the best and what shares are bold."""
    lines = ["| track | seeds | queries | " + " | ".join(f"`{name}`" for name in names) + " |"]
    lines.append("| --- " * (len(names) + 3) + "|")
    for track in tracks:
        mean = means(track)
        seeds = len({row["seed"] for row in read(track)})
        for budget in BUDGETS:
            of_all = {
                name: by_budget[budget] for name, by_budget in mean.items() if budget in by_budget
            }
            if not of_all:
                continue
            best = max(of_all.values())
            cells = [
                ""
                if name not in of_all
                else f"**{of_all[name]:.2f}**"
                if of_all[name] >= best - SHARES
                else f"{of_all[name]:.2f}"
                for name in names
            ]
            lines.append(f"| {track[5:-3]} | {seeds} | {budget} | " + " | ".join(cells) + " |")
    return lines


def tables() -> str:
    """Write F1 by track, that of all adversaries on digits, and the weaknesses that are false."""
    lines = [*table([*CHOOSE, *JUDGE], COLUMNS), ""]
    mean = means(ALL)
    lines += ["| adversary | " + " | ".join(f"{budget}" for budget in BUDGETS) + " |"]
    lines += ["| --- " * (len(BUDGETS) + 1) + "|"]
    for name in sorted(mean, key=lambda name: -float(np.mean(list(mean[name].values())))):
        cells = [f"{mean[name][budget]:.2f}" if budget in mean[name] else "" for budget in BUDGETS]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    lines += ["", "| adversary | queries | runs | weaknesses | false |", "| --- " * 5 + "|"]
    for name in DIAGNOSED:
        for budget in BUDGETS:
            rows = [
                row
                for track in (*CHOOSE, *JUDGE)
                for row in read(track)
                if row["adversary"] == name and row["budget"] == budget and "named" in row
            ]
            named, false = (sum(row[key] for row in rows) for key in ("named", "false"))
            lines.append(f"| `{name}` | {budget} | {len(rows)} | {named} | {false} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("action", choices=("run", "tables"))
    parser.add_argument("tracks", nargs="*", default=[*CHOOSE, *JUDGE])
    parser.add_argument("--adversaries", nargs="+", default=adversaries.names())
    parser.add_argument("--budgets", nargs="+", type=int, default=BUDGETS)
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--store", help="a file that keeps each world's score")
    given = parser.parse_args()
    if given.action == "tables":
        print(tables())
        return
    for track in given.tracks:
        measure(track, given.adversaries, given.budgets, given.seeds, given.store)


if __name__ == "__main__":
    main()
