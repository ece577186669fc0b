"""Diagnoses a run: how does its agent fail?"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from sada_gym.application import Application
from sada_gym.arrays import Bools
from sada_gym.diagnosis.core import diagnose_worlds
from sada_gym.diagnosis.grouping import grouped
from sada_gym.diagnosis.record import DIAGNOSIS_FILE, Diagnosis, diagnosed_before, write_diagnosis
from sada_gym.diagnosis.telling import tell
from sada_gym.errors import FileError, Notice, UserError, check_integer
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import Evaluations, evaluation_seeds, fools
from sada_gym.experiment.finished import check_samples, open_target, read_run
from sada_gym.experiment.folder import RESULT_FILE, STORE_FILE
from sada_gym.experiment.record import RunReport, RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.failures import Failures, PlayedAgain, check_seeds, list_failures
from sada_gym.files import as_path, read_model
from sada_gym.parameters import Mu

FRESH_SHARE, MOST_FRESH = 0.05, 200
"""A diagnosis spends this share of the training budget on fresh worlds, but at most so many."""

_FIRST_SEED = 2**20  # of the validation stream, whose first seeds have other purposes

OnScores = Callable[[int, int, int], object]
"""Gets the number of fresh scores so far, of all that are asked for, and of those known before."""


def diagnose(
    run: str | Path,
    *,
    fresh: int | None = None,
    confirm: int = 0,
    application: Application | str | None = None,
    workers: int = 1,
    on_scores: OnScores = lambda *_: None,
) -> Diagnosis:
    """Find one to five weaknesses of the agent that a finished run attacked.

    Rules are found among the training queries and the test samples; fresh uniform worlds inside
    and outside decide which of them stand. The diagnosis is written to the run's folder as
    diagnosis.json, and the fresh scores are kept there, so that a call that was stopped goes on
    where it was. Where the training queries are lost, a diagnosis that knew them is kept, and
    returned, until its file is removed.

    Args:
        run: The folder that `attack` wrote.
        fresh: The most fresh evaluations. None takes 5 % of the run's budget, at most 200, but at
            least 15 for each rule and 15 outside all rules. With 0 nothing is confirmed.
        confirm: Tries each failure among the samples again on so many fresh seeds, see
            `sada_gym.failures`.
        application: What the run attacked, where it cannot say it, see `replay`.
        workers: 1 evaluates in this process, more in as many others.
        on_scores: See `OnScores`.

    Raises:
        UserError: If an argument is bad, or the run is not finished or cannot be opened as it was.
    """
    folder = as_path(run, "a run's folder")
    settings, samples = read_run(folder)
    if fresh is not None:
        check_integer("fresh", fresh, 0, 100_000)
    check_seeds(confirm, "confirm")
    call = f"sada_gym.diagnosis.diagnose({str(folder)!r}, application=YOURS)"
    with open_target(settings, folder, application, call=call, workers=workers) as opened:
        check_samples(samples, opened)
        opened.parameters.validate(samples.mu)
        queries, uniform = _known_queries(folder, settings, opened.dimension)
        diagnosis = None if queries is not None else _better_diagnosis(folder, samples)
        queries = Evaluations.empty(opened.dimension) if queries is None else queries
        if diagnosis is None:
            opened.evaluator.attach(folder / STORE_FILE)
            diagnosis = diagnose_run(
                settings,
                opened.evaluator,
                queries,
                samples,
                uniform=uniform,
                fresh=fresh,
                on_scores=on_scores,
            )
        told, _ = list_and_tell(
            opened,
            settings,
            queries,
            samples,
            folder,
            diagnosis=diagnosis,
            confirm=confirm,
            on_scores=on_scores,
        )
    assert told is not None
    return told


def list_and_tell(
    opened: OpenTarget,
    settings: RunSettings,
    queries: Evaluations,
    samples: Evaluations,
    folder: Path,
    *,
    diagnosis: Diagnosis | None,
    confirm: int,
    on_scores: OnScores,
) -> tuple[Diagnosis | None, Failures | None]:
    """List a run's failures, complete its diagnosis with them, and write both into its folder.

    Args:
        opened: What the run attacked. An evaluator with a store gives it up.
        settings: The run's.
        queries: Its training queries.
        samples: Its test samples.
        folder: The run's.
        diagnosis: How the agent fails; without one the failures alone are listed.
        confirm: See `diagnose`.
        on_scores: See `OnScores`.

    Returns:
        The diagnosis with what the agent does in each weakness and how sure its failures are; and
        the failures, None where no sample fooled.
    """
    again = PlayedAgain(opened.application)
    failures = list_failures(
        opened,
        settings,
        samples,
        folder,
        seeds=confirm,
        again=again,
        group=None if diagnosis is None else partial(grouped, diagnosis, opened.parameters),
        on_scores=on_scores,
    )
    if diagnosis is not None:
        diagnosis = tell(diagnosis, opened.application, queries + samples, failures, again)
        if diagnosis != diagnosed_before(folder):
            write_diagnosis(folder, diagnosis)
    return diagnosis, failures


def diagnose_run(
    settings: RunSettings,
    evaluator: Evaluator,
    queries: Evaluations,
    samples: Evaluations,
    *,
    uniform: int,
    fresh: int | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Diagnosis:
    """Diagnose a run by its training queries, so many of whose first valid ones are `uniform`.

    The evaluator keeps the fresh scores in its store.
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

    any_world = np.zeros((1, len(application.parameters)), np.float32)

    def permits(mu: Mu) -> Bools:
        permitted = application.permits(mu)
        assert permitted is not None
        return permitted

    return diagnose_worlds(
        application.parameters,
        queries + samples,
        threshold,
        np.append(even, np.full(len(samples), samples_even)),
        evaluate=evaluate,
        fresh=most,
        enough=fresh is None,
        permits=None if application.permits(any_world) is None else permits,
        seed=settings.seed,
    )


def default_fresh(budget: int) -> int:
    """Return how many fresh evaluations a diagnosis spends after so many training queries."""
    return min(int(FRESH_SHARE * budget), MOST_FRESH)


def _known_queries(
    folder: Path, settings: RunSettings, dimension: int
) -> tuple[Evaluations | None, int]:
    """Read the training queries, and how many of the first valid ones are uniform.

    They are None where any of them is lost. A run that another version wrote may not say how many
    are uniform: then none count as such.
    """
    try:
        report = read_model(folder / RESULT_FILE, RunReport)
        asked, uniform = report.search.queries, report.uniform
    except FileError:
        asked, uniform = settings.experiment.protocol.budget, None
    seeds = evaluation_seeds(settings.seed, "train", 0, asked)
    if not seeds:
        return Evaluations.empty(dimension), 0
    found = None
    if (folder / STORE_FILE).exists():
        with EvaluationStore(folder / STORE_FILE) as store:
            context = store.context(settings.experiment.target.application)
            found = store.evaluations(context, seeds)
    return found, 0 if found is None or uniform is None else uniform.worlds


def _better_diagnosis(folder: Path, samples: Evaluations) -> Diagnosis | None:
    """Return the diagnosis in a run's folder if it knew more than the samples, and say what is."""
    lost = f"{STORE_FILE} is missing or incomplete"
    older = diagnosed_before(folder)
    if older is not None and older.worlds > len(samples.valid):
        warnings.warn(
            f"{lost}, so the older diagnosis is kept: it knew {older.worlds:,} worlds, and a new "
            f"one would know {len(samples.valid):,}. Remove {folder / DIAGNOSIS_FILE} to make it "
            "anew.",
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
