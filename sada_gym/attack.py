"""The attack, the paper's Algorithm 1: train an adversary, draw M samples, measure them."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.errors import UserTypeError, refuse_number
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import MAX_QUERIES, Evaluations
from sada_gym.files import as_path, file_errors, write_folder, write_model
from sada_gym.runs.assemble import find_target, make_adversary, make_settings
from sada_gym.runs.record import (
    ADVERSARY_FOLDER,
    RESULT_FILE,
    SAMPLES_FILE,
    STORE_FILE,
    RunReport,
    claim_folder,
    write_samples,
)
from sada_gym.runs.run import OnProgress, Run, RunProgress, Stage, ignore_progress

__all__ = ["AttackResult", "RunProgress", "Stage", "attack"]


@dataclass(frozen=True)
class AttackResult:
    """What an attack found.

    Attributes:
        report: The figures, as in result.json.
        samples: The M test samples, as in samples.npz.
        queries: The training queries (Omega).
        folder: The folder that holds the results.
        pictures: The picture files in it.
    """

    report: RunReport
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
    on_progress: OnProgress = ignore_progress,
) -> AttackResult:
    """Train an adversary against an application and measure what it learnt.

    The test samples are evaluated on seeds that training never used. Killed at any moment and
    called again with `resume=True`, it repeats no committed evaluation and ends with the same
    result.

    Args:
        environment: An environment's id, the path of a TOML file, or an `Application`.
        adversary: An adversary's name, or its class.
        out: The folder for the results: result.json, samples.npz, adversary/, pictures, run.sqlite.
        env_kwargs: Keywords of the environment's id.
        budget: Number of training queries.
        samples: Number of test samples, M in the paper; None takes the application's own number.
        seed: Seed of the adversary and of all evaluation seeds.
        preset: A named set of the adversary's options, such as `paper`.
        options: The adversary's options; they replace the preset's.
        workers: 1 evaluates in this process, more evaluate in as many others. The result does not
            depend on it, nor on the next two.
        chunk_size: The evaluations that a worker gets at a time, see `Oracle`.
        executor: Where workers run, see `Oracle`.
        resume: Whether to go on with the run that `out` holds, if it holds one.
        pictures: Whether to draw pictures.
        on_progress: Called at the start of each stage and after each committed chunk.

    Raises:
        TypeError, ValueError: If an argument is bad, or `out` holds another run.
    """
    folder = as_path(out, "the folder for the results")
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
        count = application.sample_size if samples is None else samples
        refuse_number("budget", budget, 0, MAX_QUERIES)
        refuse_number("samples", count, 1, MAX_QUERIES)
        refuse_number("seed", seed, 0)
        target = find_target(environment, env_kwargs or {}, application)
        fooling_set, ideal_set = target.halves
        chosen: dict[str, Any] = {"preset": preset, "options": options or {}}
        solver = make_adversary(
            adversary, target.dimension, seed=seed, ideal_set=ideal_set, **chosen
        )
        settings = make_settings(
            target, adversary, type(solver), budget=budget, samples=count, seed=seed, **chosen
        )
        with file_errors("make the folder", folder):
            claim_folder(folder, settings, resume=resume)
        evaluator.attach(folder / STORE_FILE)
        run = Run(
            settings,
            solver,
            evaluator,
            fooling_set=fooling_set,
            ideal_set=ideal_set,
            on_progress=on_progress,
        )
        run.train()
        # saved before it samples: loaded again, it gives the same samples
        write_folder(folder / ADVERSARY_FOLDER, solver.save)
        run.test()
        report = run.measure()
        write_samples(folder / SAMPLES_FILE, run.samples)
        write_model(folder / RESULT_FILE, report)
        drawn: tuple[Path, ...] = ()
        if pictures:
            from sada_gym.plots.attack import draw_attack

            on_progress(RunProgress("pictures"))
            drawn = draw_attack(application, run.samples, run.queries, folder)
        now = False
    finally:
        evaluator.close(now=now)
    return AttackResult(report, run.samples, run.queries, folder, drawn)
