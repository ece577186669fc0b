"""The attack, the paper's Algorithm 1: train an adversary, draw M samples, measure them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.diagnosis.record import Diagnosis, diagnosed_before, write_diagnosis
from sada_gym.diagnosis.run import diagnose_run, list_and_tell
from sada_gym.diagnosis.summary import rows as weakness_rows
from sada_gym.errors import Notice, check_integer, check_keywords
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import MAX_QUERIES
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec, name_and_class
from sada_gym.experiment.folder import (
    ADVERSARY_FOLDER,
    RESULT_FILE,
    SAMPLES_FILE,
    SOURCE_FILE,
    STORE_FILE,
    RunFolder,
    check_free,
    read_finished,
    reserve_folder,
    write_samples,
)
from sada_gym.experiment.names import check_spelling
from sada_gym.experiment.packages import packages
from sada_gym.experiment.pictures import draw_missing
from sada_gym.experiment.record import Experiment, Protocol, RunReport, RunSettings
from sada_gym.experiment.run import OnProgress, Run, RunProgress, Stage, ignore_progress
from sada_gym.experiment.summary import summary
from sada_gym.experiment.target import OpenTarget
from sada_gym.failures import Failures, check_seeds, listed_before
from sada_gym.files import as_path, file_errors, write_file, write_folder, write_model
from sada_gym.frames import Frame
from sada_gym.ids import names_file
from sada_gym.measures.failure_regions import percent
from sada_gym.measures.rates import wilson_interval
from sada_gym.parameters import ParameterSpace
from sada_gym.report.make import REPORT_FILE, report_attack

_LEARN_NOTHING = ("random", "ideal")
_FEWEST_QUERIES, _FEWEST_SAMPLES = 20, 10

__all__ = ["AttackResult", "RunProgress", "Stage", "attack"]


@dataclass(frozen=True, repr=False, eq=False)
class AttackResult:
    """What an attack found; `print` shows its summary.

    Attributes:
        report: The figures, as in result.json.
        samples: The M test samples, as in samples.npz.
        queries: The training queries (Omega).
        diagnosis: The weaknesses, as in diagnosis.json; None with `diagnose=False`.
        failures: The failures among the samples, as in failures.json; None where none fooled.
        html: report.html; None where it was not asked for.
        parameters: What mu controls; the summary then has labels and units.
        was_finished: Whether the folder held the finished run, so that nothing was evaluated.
    """

    report: RunReport
    samples: Evaluations
    queries: Evaluations
    folder: Path
    pictures: tuple[Path, ...] = ()
    was_finished: bool = False
    failures: Failures | None = None
    diagnosis: Diagnosis | None = None
    html: Path | None = None
    parameters: ParameterSpace | None = None

    def __repr__(self) -> str:
        """Write the summary: how often the agent failed, where, and by which files."""
        return summary(
            self.report,
            self.folder,
            self.files,
            self.further_rows(),
            where=self.where_rows(),
            space=self.parameters,
        )

    def where_rows(self) -> tuple[tuple[str, str], ...]:
        """Return the names and texts of the weaknesses; none where none was found."""
        return () if self.diagnosis is None else tuple(weakness_rows(self.diagnosis))

    @property
    def files(self) -> tuple[Path, ...]:
        """The report and the pictures."""
        return (*(() if self.html is None else (self.html,)), *self.pictures)

    def further_rows(self) -> tuple[tuple[str, str], ...]:
        """Return the names and texts of findings that are not in the report."""
        return () if self.failures is None else tuple(self.failures.rows())


def attack(
    environment: str | Application,
    adversary: str | type[Adversary] = "level-set",
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
    diagnose: bool = True,
    confirm: int = 0,
    pictures: bool = True,
    html: bool = True,
    progress: bool = True,
    on_progress: OnProgress | None = None,
) -> AttackResult:
    """Train an adversary against an application and measure what it learnt.

    The test samples are evaluated on seeds that training never used. Killed at any moment and
    called again with `resume=True`, it repeats no committed evaluation and ends with the same
    result.

    Args:
        environment: An environment's id, the path of a TOML file, or an `Application`.
        adversary: An adversary's name, or its class.
        out: The folder for the results: result.json, report.html, worlds.csv and so on.
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
        diagnose: Whether to find the agent's weaknesses, see `sada_gym.diagnosis.diagnose`; fresh
            worlds check them, which costs 5 % more evaluations, but at most 200, and at least 15
            for each rule and 15 elsewhere.
        confirm: Tries each failure among the samples again on so many fresh seeds, which costs as
            many more evaluations; see `sada_gym.failures`.
        pictures: Whether to draw pictures.
        html: Whether to write report.html, if pictures are drawn.
        progress: Whether to show progress on stderr: bars in a terminal, elsewhere a line every
            half minute. With `on_progress` nothing is shown.
        on_progress: Called at the start of each stage, and after each committed chunk, step of
            learning and frame.

    Raises:
        TypeError, ValueError: If an argument is bad, or `out` holds another run.
    """
    folder = as_path(out, "the folder for the results")
    check_keywords("env_kwargs", {} if env_kwargs is None else env_kwargs)
    check_integer("budget", budget, 0, MAX_QUERIES)
    check_integer("seed", seed, 0)
    if samples is not None:
        check_integer("samples", samples, 1, MAX_QUERIES)
    check_seeds(confirm, "confirm")
    # before anything heavy is imported
    check_spelling(environment, adversary, env_kwargs or {})
    with file_errors("make the folder", folder):
        check_free(folder, resume=resume)
    with (
        _progress(progress, on_progress) as report_progress,
        OpenTarget.of(
            environment, env_kwargs, workers=workers, chunk_size=chunk_size, executor=executor
        ) as opened,
    ):
        count = opened.sample_size if samples is None else samples
        check_integer("samples", count, 1, MAX_QUERIES)
        name, kind = name_and_class(adversary)
        spec = AdversarySpec.of(name, preset, options)
        solver = spec.make(opened.dimension, seed=seed, ideal_set=opened.ideal_set, kind=kind)
        settings = RunSettings(
            experiment=Experiment(
                target=opened.target,
                adversary=spec.resolve(kind=kind),
                protocol=Protocol(budget=budget, samples=count),
                seed=seed,
            ),
            label=name,
            packages=packages(opened.application, type(solver)),
        )
        if not (folder / RESULT_FILE).exists():
            for sentence in _says_little(name, budget, count):
                warnings.warn(sentence, Notice, stacklevel=2)
        with file_errors("make the folder", folder):
            reserved = reserve_folder(folder, settings, resume=resume)
            if isinstance(environment, str) and names_file(environment):
                write_file(folder / SOURCE_FILE, os.fsencode(Path(environment).absolute()))
        outcome = read_finished(folder, settings, opened.dimension) if resume else None
        was_finished = outcome is not None
        if outcome is None:
            try:
                opened.evaluator.attach(folder / STORE_FILE)
                opened.evaluator.expect(budget + count)
                run = Run(
                    settings,
                    solver,
                    opened.evaluator,
                    fooling_set=opened.fooling_set,
                    ideal_set=opened.ideal_set,
                    on_progress=report_progress,
                )
                outcome = _finish(run, reserved, opened.evaluator), run.samples, run.queries
            except BaseException:
                opened.close(now=True)
                reserved.release()
                raise
        report, test_samples, queries = outcome
        before = _diagnose(opened, outcome, folder, report_progress) if diagnose else None
        known_failures = listed_before(folder)
        diagnosis, failures = list_and_tell(
            opened,
            settings,
            queries,
            test_samples,
            folder,
            diagnosis=before,
            confirm=confirm,
            on_scores=lambda *counts: report_progress(RunProgress("confirm", *counts)),
        )
        drawn: tuple[Path, ...] = ()
        frames: dict[int, Frame] = {}
        if pictures:
            drawn = draw_missing(
                opened.application,
                *outcome,
                folder,
                report_progress,
                headline="" if diagnosis is None else diagnosis.sentence,
                anew=not was_finished,
                on_frame=frames.__setitem__,
            )
        made: Path | None = folder / REPORT_FILE
        is_known = was_finished and (diagnosis, failures) == (before, known_failures)
        is_made = is_known and (folder / REPORT_FILE).is_file()
        if not is_made:
            has_id = isinstance(environment, str) and not names_file(environment)
            made = report_attack(
                opened.application,
                settings,
                outcome,
                folder,
                env_kwargs={**(env_kwargs or {})} if has_id else None,
                frames=frames,
                html=pictures and html,
                on_progress=lambda *counts: report_progress(RunProgress("pictures", *counts)),
            )
    return AttackResult(
        report,
        test_samples,
        queries,
        folder,
        drawn,
        was_finished,
        failures,
        diagnosis,
        made,
        opened.parameters,
    )


def _says_little(adversary: str, budget: int, samples: int) -> Iterator[str]:
    """Say, before anything is spent, why a result will say nothing."""
    if adversary not in _LEARN_NOTHING and budget < _FEWEST_QUERIES:
        yield (
            f"By {budget:,} queries {adversary} can hardly learn where the agent fails. Give it at "
            f"least {_FEWEST_QUERIES}, better some hundred (--budget, budget=)."
        )
    if samples < _FEWEST_SAMPLES:
        low = wilson_interval(samples, samples)[0]
        yield (
            f"The fooling rate of so few samples ({samples}) says little: if all of them fooled, "
            f"it could be {percent(low)} as well. Draw at least {_FEWEST_SAMPLES} (--samples, "
            "samples=)."
        )


def _finish(run: Run, reserved: RunFolder, evaluator: Evaluator) -> RunReport:
    folder, store = reserved.folder, evaluator.store
    assert store is not None
    run.train()
    reserved.check(run.settings, store)
    # saved before it samples: loaded again, it gives the same samples
    write_folder(folder / ADVERSARY_FOLDER, run.adversary.save)
    run.test()
    report = run.measure(explain=True)
    reserved.check(run.settings, store)
    write_samples(folder / SAMPLES_FILE, run.samples)
    write_model(folder / RESULT_FILE, report)
    return report


def _diagnose(
    opened: OpenTarget,
    outcome: tuple[RunReport, Evaluations, Evaluations],
    folder: Path,
    on_progress: OnProgress,
) -> Diagnosis:
    """Read the diagnosis of a run, or make it."""
    known = diagnosed_before(folder)
    if known is not None:
        return known
    report, samples, queries = outcome
    on_progress(RunProgress("diagnose"))
    opened.evaluator.attach(folder / STORE_FILE)
    try:
        diagnosis = diagnose_run(
            report.settings,
            opened.evaluator,
            queries,
            samples,
            uniform=0 if report.uniform is None else report.uniform.worlds,
            on_scores=lambda *counts: on_progress(RunProgress("diagnose", *counts)),
        )
    finally:
        opened.evaluator.detach()
    write_diagnosis(folder, diagnosis)
    return diagnosis


def _progress(shown: bool, on_progress: OnProgress | None) -> AbstractContextManager[OnProgress]:
    if on_progress is not None or not shown:
        return nullcontext(on_progress or ignore_progress)
    from rich.console import Console

    from sada_gym.progress import AttackProgress

    return AttackProgress(Console(stderr=True))
