"""The attack, the paper's Algorithm 1: train an adversary, draw M samples, measure them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from sada_gym.adversaries.base import Adversary
from sada_gym.analyses.diagnose import analyse
from sada_gym.analyses.failures import check_seeds
from sada_gym.analyses.pictures import draw_missing
from sada_gym.analyses.report.make import report_attack
from sada_gym.application import Application
from sada_gym.errors import Notice, check_integer, check_keywords
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.oracle import MAX_QUERIES
from sada_gym.experiment.adversary import AdversarySpec, name_and_class
from sada_gym.experiment.algorithm import (
    Algorithm1,
    OnProgress,
    RunProgress,
    Stage,
    ignore_progress,
)
from sada_gym.experiment.names import check_spelling
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import Experiment, Protocol, RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.figures import percent
from sada_gym.foundations.files import as_path, file_errors, write_folder, write_model
from sada_gym.foundations.frames import Frame
from sada_gym.measures.rates import wilson_interval
from sada_gym.run import Run, load_run
from sada_gym.run.folder import (
    ADVERSARY_FOLDER,
    RESULT_FILE,
    SAMPLES_FILE,
    STORE_FILE,
    RunFolder,
    RunRecord,
    TemporaryFolder,
    check_free,
    reserve_folder,
    write_samples,
)
from sada_gym.run.given import Given
from sada_gym.run.run import read_finished

_LEARN_NOTHING = ("random", "ideal")
_FEWEST_QUERIES, _FEWEST_SAMPLES = 20, 10

__all__ = ["RunProgress", "Stage", "attack"]


def attack(
    environment: str | Application,
    adversary: str | type[Adversary] = "level-set",
    *,
    out: str | Path | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    budget: int = 2_000,
    samples: int | None = None,
    seed: int = 0,
    preset: str | None = None,
    options: Mapping[str, Any] | None = None,
    workers: int | Workers = 1,
    resume: bool = False,
    diagnose: bool = True,
    confirm: int | None = None,
    pictures: bool = True,
    html: bool = True,
    progress: bool = True,
    on_progress: OnProgress | None = None,
) -> Run:
    """Train an adversary against an application and measure what it learnt.

    The test samples are evaluated on seeds that training never used. If the process is killed,
    call it again with `resume=True`: no committed evaluation is repeated, and the result is the
    same.

    Args:
        environment: An environment's id, the path of a TOML file, or an `Application`.
        adversary: An adversary's name, or its class.
        out: The folder for the results: result.json, report.html, worlds.csv and so on. None takes
            a temporary one, which is removed with the `Run`.
        env_kwargs: Keywords of the environment's id.
        budget: Number of training queries.
        samples: Number of test samples, M in the paper; None takes the application's own number.
        seed: Seed of the adversary and of all evaluation seeds.
        preset: A named set of the adversary's options, such as `paper`.
        options: The adversary's options; they replace the preset's.
        workers: 1 evaluates in this process, more evaluate in as many others. The result does not
            depend on it. See :class:`~sada_gym.Workers`.
        resume: Whether to continue the run that `out` holds, if it holds one.
        diagnose: Whether to find the agent's weaknesses, see `sada_gym.diagnose`. Fresh worlds
            check them, which costs 5 % more evaluations: at most 200, at least 15 for each rule
            and 15 elsewhere. If the world in ordinary use is known, it and worlds around it are
            played, too; the summary says how many.
        confirm: On how many fresh seeds to try each failing sample again, one evaluation each; see
            `sada_gym.measures.failures`. None takes 2, for as many failures as fit into 5 % more
            evaluations.
        pictures: Whether to draw pictures.
        html: Whether to write report.html, if pictures are drawn.
        progress: Whether to show progress on stderr: bars in a terminal, elsewhere a line every
            half minute. With `on_progress` nothing is shown.
        on_progress: Called at the start of each stage, and after each committed chunk, step of
            learning and frame.

    Raises:
        TypeError, ValueError: If an argument is bad, or `out` holds another run.
    """
    kept = None if out is not None else TemporaryFolder()
    folder = kept.path if kept is not None else as_path(out, "the folder for the results")
    check_keywords("env_kwargs", {} if env_kwargs is None else env_kwargs)
    check_integer("budget", budget, 0, MAX_QUERIES)
    check_integer("seed", seed, 0)
    if samples is not None:
        check_integer("samples", samples, 1, MAX_QUERIES)
    check_seeds(0 if confirm is None else confirm, "confirm")
    # before anything heavy is imported
    check_spelling(environment, adversary, env_kwargs or {})
    with file_errors("make the folder", folder):
        check_free(folder, resume=resume)
    with (
        _progress(progress, on_progress) as report,
        OpenTarget.of(environment, env_kwargs, workers=workers) as opened,
    ):
        solver, settings = _prepared(
            opened,
            adversary,
            budget=budget,
            samples=samples,
            seed=seed,
            preset=preset,
            options=options,
        )
        if not (folder / RESULT_FILE).exists():
            for sentence in _says_little(settings):
                warnings.warn(sentence, Notice, stacklevel=2)
        record = RunRecord(settings=settings, given=Given.of(environment, env_kwargs or {}))
        with file_errors("make the folder", folder):
            reserved = reserve_folder(folder, record, resume=resume)
        run = read_finished(folder, settings, opened.dimension) if resume else None
        if run is None:
            run = _train_and_test(reserved, settings, solver, opened, report, explore=diagnose)
        is_new = _diagnosed(run, opened, diagnose=diagnose, confirm=confirm, on_progress=report)
        frames: dict[int, Frame] = {}
        if pictures:
            anew = not run.was_finished
            frames = draw_missing(run, opened.application, report, anew=anew)
        if is_new or not run.was_finished or run.html is None:
            report_attack(
                run,
                opened.application,
                frames,
                html=pictures and html,
                on_progress=lambda *counts: report(RunProgress("pictures", *counts)),
            )
    return replace(run, kept=kept)


def _prepared(
    opened: OpenTarget,
    adversary: str | type[Adversary],
    *,
    budget: int,
    samples: int | None,
    seed: int,
    preset: str | None,
    options: Mapping[str, Any] | None,
) -> tuple[Adversary, RunSettings]:
    """Make the adversary, and the record of the run."""
    name, kind = name_and_class(adversary)
    spec = AdversarySpec.of(name, preset, options)
    solver = spec.make(opened.dimension, seed=seed, ideal_set=opened.ideal_set, kind=kind)
    count = opened.sample_size if samples is None else samples
    check_integer("samples", count, 1, MAX_QUERIES)
    experiment = Experiment(
        target=opened.target,
        adversary=spec.resolve(kind=kind),
        protocol=Protocol(budget=budget, samples=count),
        seed=seed,
    )
    used = packages(opened.application, type(solver))
    return solver, RunSettings(experiment=experiment, label=name, packages=used)


def _says_little(settings: RunSettings) -> Iterator[str]:
    """Say, before anything is spent, why a result will say nothing."""
    adversary, protocol = settings.label, settings.experiment.protocol
    if adversary not in _LEARN_NOTHING and protocol.budget < _FEWEST_QUERIES:
        yield (
            f"From {protocol.budget:,} queries {adversary} can hardly learn where the agent fails. "
            f"Use at least {_FEWEST_QUERIES}, better some hundred (--budget, budget=)."
        )
    if (samples := protocol.samples) < _FEWEST_SAMPLES:
        low = wilson_interval(samples, samples)[0]
        yield (
            f"The fooling rate of only {samples} samples says little: even if all of them fooled, "
            f"the true rate could be {percent(low)}. Draw at least {_FEWEST_SAMPLES} (--samples, "
            "samples=)."
        )


def _diagnosed(
    run: Run, opened: OpenTarget, *, diagnose: bool, confirm: int | None, on_progress: OnProgress
) -> bool:
    """Diagnose a run, unless it is, and list failures; return whether that changed its folder."""
    known = run.diagnosis if diagnose else None
    if diagnose and known is None:
        on_progress(RunProgress("diagnose"))
    return analyse(
        run,
        opened,
        rules=diagnose,
        diagnosis=known,
        confirm=confirm,
        on_scores=lambda stage, *counts: on_progress(RunProgress(stage, *counts)),
    )


def _train_and_test(
    reserved: RunFolder,
    settings: RunSettings,
    solver: Adversary,
    opened: OpenTarget,
    on_progress: OnProgress,
    *,
    explore: bool,
) -> Run:
    """Run Algorithm 1, and write what it finds."""
    folder, evaluator = reserved.folder, opened.evaluator
    protocol = settings.experiment.protocol
    try:
        evaluator.attach(folder / STORE_FILE)
        evaluator.expect(protocol.budget + protocol.samples)
        algorithm = Algorithm1(
            settings,
            solver,
            evaluator,
            fooling_set=opened.fooling_set,
            ideal_set=opened.ideal_set,
            on_progress=on_progress,
        )
        store = evaluator.store
        assert store is not None
        algorithm.train()
        reserved.check(settings, store)
        # saved before it samples: loaded again, it gives the same samples
        write_folder(folder / ADVERSARY_FOLDER, algorithm.adversary.save)
        algorithm.test()
        result = algorithm.measure(explain=True, explore=explore)
        reserved.check(settings, store)
        write_samples(folder / SAMPLES_FILE, algorithm.samples)
        write_model(folder / RESULT_FILE, result)
        evaluator.detach()
    except BaseException:
        opened.close(now=True)
        reserved.release()
        raise
    return load_run(folder)


def _progress(shown: bool, on_progress: OnProgress | None) -> AbstractContextManager[OnProgress]:
    if on_progress is not None or not shown:
        return nullcontext(on_progress or ignore_progress)
    from rich.console import Console

    from sada_gym.experiment.progress import AttackProgress

    return AttackProgress(Console(stderr=True))
