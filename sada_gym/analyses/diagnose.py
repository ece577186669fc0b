"""Diagnoses a run: how does its agent fail?"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.analyses.failures import PlayedAgain, check_seeds, list_failures
from sada_gym.analyses.telling import tell
from sada_gym.application import Application
from sada_gym.errors import FileError, Notice, UserError, check_integer
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.stored import OnScores
from sada_gym.evaluations import Evaluations, evaluation_seeds, fools
from sada_gym.experiment.record import RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.arrays import Bools
from sada_gym.measures.diagnosis.core import diagnose_worlds
from sada_gym.measures.diagnosis.grouping import grouped
from sada_gym.measures.diagnosis.record import DIAGNOSIS_FILE, Diagnosis, write_diagnosis
from sada_gym.parameters import Mu
from sada_gym.run import Run
from sada_gym.run.folder import STORE_FILE
from sada_gym.run.run import as_run

FRESH_SHARE, MOST_FRESH = 0.05, 200
"""A diagnosis spends this share of the training budget on fresh worlds, but at most so many."""

_FIRST_SEED = 2**20  # of the validation stream, whose first seeds have other purposes

OnAnalysis = Callable[[Literal["diagnose", "confirm"], int, int, int], object]
"""Gets what the scores are for, and what `OnScores` gets."""


def diagnose(
    run: Run | str | Path,
    *,
    fresh: int | None = None,
    confirm: int = 0,
    application: Application | str | None = None,
    workers: int | Workers = 1,
    on_scores: OnScores = lambda *_: None,
) -> Diagnosis:
    """Find one to five weaknesses of the agent that a finished run attacked.

    It looks for rules in the training queries and test samples, and checks them on fresh uniform
    worlds inside and outside the rules. It returns a :class:`.Diagnosis`. The run's folder keeps it
    (diagnosis.json) and the fresh scores, so a stopped call continues where it stopped. If the
    training queries are missing, it returns the stored diagnosis; delete that to make a new one.

    Args:
        run: A run, or its folder.
        fresh: The most fresh evaluations. None takes 5 % of the run's budget, at most 200, but at
            least 15 for each rule and 15 outside all rules. With 0 no rule is checked.
        confirm: The number of fresh seeds on which each failing sample is tried again; the results
            are `run.failures`.
        application: What the run attacked, if the run does not record it, see :meth:`.Run.open`.
        workers: See :class:`~sada_gym.Workers`.
        on_scores: A function of three counts: scores so far, all scores, and scores from the store.

    Raises:
        UserError: If an argument is bad, or the run is not finished or cannot be opened as it was.
    """
    finished = as_run(run)
    if fresh is not None:
        check_integer("fresh", fresh, 0, 100_000)
    check_seeds(confirm, "confirm")
    with finished.open(application, workers=workers) as opened:
        older = None if finished.queries is not None else _better_diagnosis(finished)
        analyse(
            finished,
            opened,
            diagnosis=older,
            fresh=fresh,
            confirm=confirm,
            on_scores=lambda _, *counts: on_scores(*counts),
        )
    diagnosis = finished.diagnosis
    assert diagnosis is not None
    return diagnosis


def analyse(
    run: Run,
    opened: OpenTarget,
    *,
    rules: bool = True,
    diagnosis: Diagnosis | None = None,
    fresh: int | None = None,
    confirm: int | None = 0,
    on_scores: OnAnalysis = lambda *_: None,
) -> bool:
    """Diagnose a run, list its failures, and write both into its folder.

    Args:
        run: The run.
        opened: What it attacked. An evaluator with a store gives it up.
        rules: Whether to diagnose it; without, the failures alone are listed.
        diagnosis: An earlier one, which is completed instead of made again.
        fresh: See `diagnose`.
        confirm: See `diagnose`, and for None `sada_gym.attack`.
        on_scores: See `OnAnalysis`.

    Returns:
        Whether this changed what the folder held.
    """
    before = run.diagnosis, run.failures
    queries = run.queries
    if queries is None:
        queries = Evaluations.empty(opened.dimension)
    if rules and diagnosis is None:
        opened.evaluator.attach(run.folder / STORE_FILE)
        diagnosis = find_weaknesses(
            run.settings,
            opened.evaluator,
            queries,
            run.samples,
            uniform=_uniform(run),
            fresh=fresh,
            on_scores=partial(on_scores, "diagnose"),
        )
        opened.evaluator.detach()
    again = PlayedAgain(opened.application)
    failures = list_failures(
        run,
        opened,
        seeds=confirm,
        again=again,
        group=None if diagnosis is None else partial(grouped, diagnosis, opened.parameters),
        on_scores=partial(on_scores, "confirm"),
    )
    if diagnosis is not None:
        diagnosis = tell(diagnosis, opened.application, queries + run.samples, failures, again)
        if diagnosis != before[0]:
            write_diagnosis(run.folder, diagnosis)
    return (diagnosis, failures) != before


def find_weaknesses(
    settings: RunSettings,
    evaluator: Evaluator,
    queries: Evaluations,
    samples: Evaluations,
    *,
    uniform: int,
    fresh: int | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Diagnosis:
    """Find weaknesses by training queries, so many of whose first valid ones are `uniform`.

    They are without what the agent does there. The evaluator keeps fresh scores in its store.
    """
    application = evaluator.application
    assert application is not None
    experiment = settings.experiment
    threshold = experiment.target.fooling_threshold
    queries = queries.valid
    even = np.arange(len(queries)) < uniform
    samples_even = experiment.adversary.name == "random"
    most = default_fresh(experiment.protocol.budget) if fresh is None else fresh
    spent = 0

    def evaluate(mu: Mu) -> tuple[Bools, Bools]:
        nonlocal spent
        seeds = evaluation_seeds(settings.seed, "validation", _FIRST_SEED + spent, len(mu))
        done, total = spent, max(most, spent + len(mu))
        spent += len(mu)

        def report(count: int, cached: int) -> None:
            on_scores(done + count, total, cached)

        try:
            answer = evaluator.evaluate(mu, seeds, report)
        except UserError:  # too many worlds broke: the known ones have to do
            return np.zeros(len(mu), np.bool_), np.zeros(len(mu), np.bool_)
        valid = np.ones(len(mu), np.bool_)
        valid[[*answer.invalid]] = False
        return fools(answer.scores, threshold) & valid, valid

    return diagnose_worlds(
        application.parameters,
        queries + samples,
        threshold,
        np.append(even, np.full(len(samples), samples_even)),
        evaluate=evaluate,
        fresh=most,
        enough=fresh is None,
        permits=application.permits,
        seed=settings.seed,
    )


def default_fresh(budget: int) -> int:
    """Return how many fresh evaluations a diagnosis spends after so many training queries."""
    return min(int(FRESH_SHARE * budget), MOST_FRESH)


def _uniform(run: Run) -> int:
    """Count the first valid queries that are uniform; none where that is not known."""
    try:
        uniform = run.result.uniform
    except FileError:  # another version wrote it
        return 0
    return 0 if run.queries is None or uniform is None else uniform.worlds


def _better_diagnosis(run: Run) -> Diagnosis | None:
    """Return the diagnosis in a run's folder if it knew more than the samples, and say what is."""
    lost = f"{STORE_FILE} is missing or incomplete"
    older, now = run.diagnosis, len(run.samples.valid)
    if older is not None and older.worlds > now:
        warnings.warn(
            f"{lost}, so the older diagnosis is kept: it knew {older.worlds:,} worlds, and a new "
            f"one would know {now:,}. Remove {run.folder / DIAGNOSIS_FILE} to make it again.",
            Notice,
            stacklevel=3,
        )
        return older
    warnings.warn(
        f"{lost}: the diagnosis knows the samples alone, and finds less than with the training "
        "queries.",
        Notice,
        stacklevel=3,
    )
    return None
