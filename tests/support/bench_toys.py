"""Cheap tracks and adversaries for the benchmark's tests, which any process can import."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Executor, Future
from pathlib import Path

import gymnasium as gym
import numpy as np
from toy import Greedy, Toy

from sada_gym.adversaries.base import Query
from sada_gym.application import Application
from sada_gym.board.benchmark.folder import read_costs
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.suite import BenchmarkSuite, Budget, Table
from sada_gym.board.results.entry import read_entries
from sada_gym.board.results.models import entry_name
from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.errors import BudgetTooSmall
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import place_of
from sada_gym.measures.reference import reference_mu, reference_seeds, write_reference

ANALYTIC = "SADA-Analytic-v0"
LOGGED = "bench_toys:Logged-v0"


class LoggedEnv(AdversaryEnv):
    """`Toy`, slowed down and logged as environment variables say."""

    def __init__(self) -> None:
        pause = float(os.environ.get("TOY_PAUSE_S", "0"))
        super().__init__(Toy(pause_s=pause, log=os.environ.get("TOY_LOG")))


if "Logged-v0" not in gym.registry:
    gym.register("Logged-v0", entry_point="bench_toys:LoggedEnv")


class Picky(Greedy):
    """It refuses budgets below 100."""

    def train(self, oracle: Query) -> None:
        if oracle.remaining < 100:
            raise BudgetTooSmall(f"Expected a budget of at least 100, got {oracle.remaining}.")
        super().train(oracle)


class Buggy(Greedy):
    """It fails for no good reason."""

    def train(self, oracle: Query) -> None:
        raise KeyError("bug")


class Wrong(Greedy):
    """It fails with the kind of error that bad input gets."""

    def train(self, oracle: Query) -> None:
        raise ValueError("a bug that looks like bad input")


class Deadly(Greedy):
    """Its process is killed, as the system does where memory is short."""

    def train(self, oracle: Query) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Fragile(Greedy):
    """Its process is killed once, in mid-run; a file remembers that."""

    def train(self, oracle: Query) -> None:
        super().train(oracle)
        deaths = Path(os.environ["TOY_DEATHS"])
        if len(deaths.read_text()) < 1:
            with deaths.open("a") as file:
                file.write("x")
            os.kill(os.getpid(), signal.SIGKILL)


class Short(Greedy):
    """It gives a sample too few."""

    def sample(self, n: int) -> np.ndarray:
        return super().sample(n)[: max(n - 1, 1)]


class Inline(Executor):
    """It does a job at once, where it is submitted."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Recorder(BenchmarkCallback):
    """A callback that keeps what it is called with."""

    def __init__(self) -> None:
        self.progress, self.finished = [], []

    def on_progress(self, run, progress) -> None:
        self.progress.append((str(run), progress))

    def on_finish(self, run, timing) -> None:
        self.finished.append((run, timing))


def make_reference(folder: Path, track: str, points: int = 600, seeds: int = 2) -> Application:
    """Write a small reference set of a track."""
    application = make_application(track)
    mu = reference_mu(len(application.parameters), points, 0)
    asked = [seed for point in range(points) for seed in reference_seeds(point, seeds)]
    scores = application.evaluate(np.repeat(mu, seeds, axis=0), asked).score
    write_reference(folder, track, application, scores.reshape(points, seeds), sobol_seed=0)
    return application


def made(entries: Path) -> list[tuple[str, str, int]]:
    """Return the entry, the result and the seed of all finished runs."""
    return [
        (entry.metadata.name, place, claims.seed)
        for entry in read_entries(entries)
        for place, result in entry.results.items()
        for claims in result.claimed.seeds
    ]


def run_in(entries: Path, label: str, rule: str, seed: int = 0, track: str = ANALYTIC):
    """Return what the entries hold of a run: its result, its seed there, and its samples."""
    [entry] = [e for e in read_entries(entries) if e.metadata.name == entry_name(label)]
    result = entry.results[place_of(track, "", rule)]
    [claims] = [claims for claims in result.claimed.seeds if claims.seed == seed]
    return result.claimed, claims, result.samples.get(seed)


def costs_of(out: Path, label: str, table: str, seed: int = 0):
    """Return the last costs of a run."""
    key = (label, table, seed)
    return [cost for cost in read_costs(out) if (cost.label, cost.table, cost.seed) == key][-1]


def contents(out: Path) -> dict[str, bytes]:
    """Return all files whose bytes do not depend on time: of the stores, the order of rows does."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.suffix not in (".sqlite", ".jsonl")
    }


def suite(*adversaries: str, track: str = ANALYTIC, budgets=(120, 60), **changes) -> BenchmarkSuite:
    """A small suite, a table for each budget."""
    tables = tuple(
        Table(name=f"n{budget}", title=f"Budget {budget}", note="", budget=Budget(queries=budget))
        for budget in budgets
    )
    return BenchmarkSuite(
        name="small",
        tracks=(track,),
        tables=tuple(table.model_copy(update={"samples": 30}) for table in tables),
        adversaries={name: AdversarySpec(name=name) for name in adversaries},
        **{"images": 0, **changes},
    )
