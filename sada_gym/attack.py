"""The attack, the paper's Algorithm 1: train an adversary, draw M samples, measure them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.errors import UserError, UserTypeError, refuse_number
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import MAX_QUERIES, Evaluations, Oracle
from sada_gym.evaluation.store import Context
from sada_gym.files import file_errors, write_folder, write_model
from sada_gym.measures.rates import attack_fooling_rate, mu_std, nearest_neighbours
from sada_gym.parameters import Mu
from sada_gym.runs.record import (
    ADVERSARY_FOLDER,
    RESULT_FILE,
    SAMPLES_FILE,
    STORE_FILE,
    AttackReport,
    AttackSettings,
    Distances,
    TrainingReport,
    claim_folder,
    feasible_rate,
    json_compatible,
    packages,
    write_samples,
)

Stage = Literal["train", "learn", "sample", "test", "pictures"]
"""What an attack does now: training is to query (`train`) and to `learn` from the answers."""


class AttackProgress(Protocol):
    """A progress callback of `attack`: called when a stage begins or goes on, and after chunks."""

    def __call__(self, stage: Stage, done: int, total: int, known: int) -> None:
        """Show `done` of `total` evaluations of a stage, `known` of them from the store.

        `learn` and `sample` evaluate nothing: there all three are 0.
        """


class _TrainingOracle(Oracle):
    """The oracle of the training: it reports when the adversary queries and when it learns."""

    def __init__(self, evaluator: Evaluator, settings: AttackSettings, show: AttackProgress):
        self._show = show
        super().__init__(
            evaluator,
            budget=settings.budget,
            seed=settings.seed,
            progress=lambda *counts: show("train", *counts),
        )

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, see `Oracle`."""
        self._report(0, 0)
        scores = super().__call__(mu)
        self._show("learn", 0, 0, 0)
        return scores


@dataclass(frozen=True)
class AttackResult:
    """What an attack found.

    Attributes:
        report: The figures, as in result.json.
        samples: The M test samples, as in samples.npz.
        queries: The training queries (Omega).
        folder: Where the results are.
        pictures: The pictures drawn.
    """

    report: AttackReport
    samples: Evaluations
    queries: Evaluations
    folder: Path
    pictures: tuple[Path, ...] = ()


def attack(
    environment: str | Application,
    adversary: str | type[Adversary] = "bbgan",
    *,
    out: str | Path,
    env_kwargs: Mapping[str, Any] | None = None,
    budget: int = 2_000,
    samples: int | None = None,
    seed: int = 0,
    preset: str | None = None,
    options: Mapping[str, Any] | None = None,
    workers: int = 1,
    chunk_size: int | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    pictures: bool = True,
    progress: AttackProgress | None = None,
) -> AttackResult:
    """Train an adversary against an application and measure what it learnt.

    The test samples are evaluated on seeds that training never used. Killed at any moment and
    called again with `resume=True`, it repeats no committed evaluation and ends with the same
    result.

    Args:
        environment: An environment's id, or an `Application`.
        adversary: An adversary's name, or a class.
        out: Folder for the results: result.json, samples.npz, adversary/, pictures, run.sqlite.
        env_kwargs: Keywords of the environment's id.
        budget: Number of training queries.
        samples: Number of test samples; None takes the application's own (M in the paper).
        seed: Seed of the adversary and of all evaluation seeds.
        preset: Named set of the adversary's options to start from, such as `paper`.
        options: The adversary's options; they go before the preset's.
        workers: 1 evaluates in this process, more in as many others. No part of the result.
        chunk_size: As of `Oracle`. No part of the result.
        executor: As of `Oracle`. No part of the result.
        resume: Go on with the run that `out` holds, if it holds one.
        pictures: Whether to draw them.
        progress: Called after each committed chunk.

    Raises:
        TypeError, ValueError: If an argument is bad, or `out` holds another run.
    """
    folder = Path(out)
    evaluator = Evaluator(
        environment,
        env_kwargs=env_kwargs,
        workers=workers,
        chunk_size=chunk_size,
        executor=executor,
    )
    application = evaluator.application
    if application is None:
        raise UserTypeError(
            f"Expected an environment id or an Application to attack, got {environment!r}. "
            "Wrap a function in an Application: it has parameters and an agent to name."
        )
    now = True
    try:
        solver = _make(adversary, len(application.parameters), seed, preset, options or {})
        settings = _settings(
            environment, application, adversary, budget, samples, seed, preset, options or {}
        )
        with file_errors("make the folder", folder):
            claim_folder(folder, settings, resume=resume)
        evaluator.attach(folder / STORE_FILE)
        result = _run(solver, evaluator, application, settings, folder, progress or _silent)
        if pictures:
            result = _draw(result, application, progress or _silent)
        now = False
    finally:
        evaluator.close(now=now)
    return result


def _run(
    adversary: Adversary,
    evaluator: Evaluator,
    application: Application,
    settings: AttackSettings,
    folder: Path,
    progress: AttackProgress,
) -> AttackResult:
    """Algorithm 1; everything it needs is checked and open."""
    oracle = _TrainingOracle(evaluator, settings, progress)
    adversary.train(oracle)
    write_folder(folder / ADVERSARY_FOLDER, adversary.save)

    progress("sample", 0, 0, 0)
    mu = adversary.sample(settings.samples)
    if np.shape(mu) != (settings.samples, oracle.dimension):
        raise UserError(
            f"Expected samples of shape ({settings.samples}, {oracle.dimension}) from "
            f"{type(adversary).__name__}.sample, got {np.shape(mu)}. Mend the adversary."
        )
    progress("test", 0, settings.samples, 0)
    test = Oracle(
        evaluator,
        budget=settings.samples,
        seed=settings.seed,
        stream="test",
        progress=lambda *counts: progress("test", *counts),
    )
    test(mu)

    samples, queries = test.record, oracle.record
    feasible = application.feasible(samples.mu, samples.seed.tolist())
    report = _report(settings, oracle.threshold, samples, queries, tuple(adversary.flags), feasible)
    write_samples(folder / SAMPLES_FILE, samples)
    write_model(folder / RESULT_FILE, report)

    return AttackResult(report, samples, queries, folder)


def _draw(result: AttackResult, application: Application, progress: AttackProgress) -> AttackResult:
    from sada_gym.plots.attack import draw_pictures

    progress("pictures", 0, 1, 0)
    drawn = draw_pictures(application, result.samples, result.queries, result.folder)
    progress("pictures", 1, 1, 0)
    return replace(result, pictures=drawn)


def _make(
    adversary: str | type[Adversary],
    dimension: int,
    seed: int,
    preset: str | None,
    options: Mapping[str, Any],
) -> Adversary:
    taken = sorted({"name", "dimension", "seed"} & set(options))
    if taken:
        raise UserError(
            f"Expected the adversary's own options, got {taken[0]!r}, which the attack sets itself."
        )
    chosen = dict(options) if preset is None else {"preset": preset, **options}
    if isinstance(adversary, str):
        from sada_gym import adversaries

        return adversaries.make(adversary, dimension, seed=seed, **chosen)
    if not (isinstance(adversary, type) and issubclass(adversary, Adversary)):
        raise UserTypeError(f"Expected an adversary's name or class, got {adversary!r}.")
    return adversary(dimension, seed=seed, **chosen)


def _settings(
    environment: str | Application,
    application: Application,
    adversary: str | type[Adversary],
    budget: int,
    samples: int | None,
    seed: int,
    preset: str | None,
    options: Mapping[str, Any],
) -> AttackSettings:
    count = application.sample_size if samples is None else samples
    for name, value, least, most in (
        ("budget", budget, 0, MAX_QUERIES),
        ("samples", count, 1, MAX_QUERIES),
        ("seed", seed, 0, None),
    ):
        refuse_number(name, value, least, most)
    context = Context.of(application)
    return AttackSettings(
        environment=environment
        if isinstance(environment, str)
        else f"{context.name}-v{context.version}",
        application=context.name,
        version=context.version,
        application_settings=json.loads(context.settings),
        agent=application.agent_name,
        fingerprint=context.fingerprint,
        adversary=adversary if isinstance(adversary, str) else adversary.name,
        preset=preset,
        options=json_compatible(options),
        budget=budget,
        samples=count,
        seed=seed,
        packages=packages(),
    )


def _report(
    settings: AttackSettings,
    threshold: float,
    samples: Evaluations,
    queries: Evaluations,
    flags: tuple[str, ...],
    feasible: npt.NDArray[np.bool_] | None,
) -> AttackReport:
    rate = attack_fooling_rate(samples.score, threshold)
    fooling = queries.score <= threshold
    return AttackReport(
        settings=settings,
        fooling_threshold=threshold,
        afr=rate.rate,
        afr_interval_95=(rate.low, rate.high),
        fooled=rate.fooled,
        mean_score=float(samples.score.mean()),
        mu_std=mu_std(samples.mu),
        nearest_query=_distances(samples.mu, queries.mu),
        nearest_fooling_query=_distances(samples.mu, queries.mu[fooling]),
        training=TrainingReport(
            queries=len(queries),
            fooled=int(fooling.sum()),
            fooling_rate=float(fooling.mean()) if len(queries) else None,
            mean_score=float(queries.score.mean()) if len(queries) else None,
        ),
        seeds={
            "adversary": settings.seed,
            "oracle": settings.seed,
            "training_stream": "train",
            "test_stream": "test",
        },
        flags=flags,
        feasible=feasible_rate(samples.score <= threshold, feasible),
    )


def _distances(samples: Mu, queries: Mu) -> Distances | None:
    if not len(queries):
        return None
    distances: npt.NDArray[np.float64] = nearest_neighbours(samples, queries)[0]
    return Distances(
        minimum=float(distances.min()),
        median=float(np.median(distances)),
        mean=float(distances.mean()),
        maximum=float(distances.max()),
    )


def _silent(stage: Stage, done: int, total: int, known: int) -> None:
    """Say nothing."""
