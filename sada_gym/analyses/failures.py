"""Lists the failures among a run's samples: what the agent does, how sure they are."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from sada_gym.application import Application
from sada_gym.errors import Notice, UserTypeError, check_integer, described
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.stored import FreshScores, OnScores, try_again
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.arrays import Indices
from sada_gym.foundations.behaviour import Behaviour, Behaviours, Plain
from sada_gym.foundations.files import shown, write_model
from sada_gym.measures.failures import FAILURES_FILE, Failure, FailureGroup, Failures, Group
from sada_gym.measures.groups import distinct, words
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Mu
from sada_gym.run import Run
from sada_gym.run.folder import ELSEWHERE_FILE
from sada_gym.run.run import as_run

MOST_SEEDS = 1_000
USUAL_SEEDS, _SHARE_AGAIN, _FEWEST_AGAIN = 2, 0.05, 5
"""Unless asked for more, an attack tries failures again on so many fresh seeds: all of them, or as
many as this share of its evaluations pays for; none where that is fewer than the last."""
_MOST_LISTED = 1_000
_PLAYED, _FEWEST_PLAYED, _PLAYED_SHARE = 10, 3, 0.02
"""Failures that are played again to see what the agent does: at most so many, and this share of
the run's evaluations."""


def confirm_failures(
    run: Run | str | Path,
    seeds: int = 3,
    *,
    application: Application | str | None = None,
    workers: int | Workers = 1,
    on_scores: OnScores = lambda *_: None,
) -> Failures | None:
    """Try each failure of a finished run again on fresh seeds, and rewrite failures.json.

    The scores are kept in the run's folder, so that a stopped call continues where it was. A later
    call with more seeds evaluates only the new ones.

    Args:
        run: A run, or its folder.
        seeds: The number of fresh seeds for each failure, from 0.
        application: What the run attacked, if the run does not record it, see :meth:`.Run.open`.
        workers: See :class:`~sada_gym.Workers`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Returns:
        The contents of failures.json; None if no sample fooled.

    Raises:
        UserError: If an argument is bad, or the run is not finished or cannot be opened as it was.
    """
    check_seeds(seeds)
    finished = as_run(run)
    with finished.open(application, workers=workers) as opened:
        return list_failures(finished, opened, seeds=seeds, on_scores=on_scores)


def check_seeds(seeds: object, name: str = "seeds") -> None:
    """Raise a UserError unless a number of fresh seeds is an int from 0 to `MOST_SEEDS`."""
    check_integer(name, seeds, 0, MOST_SEEDS)


def list_failures(
    run: Run,
    opened: OpenTarget,
    *,
    seeds: int | None = 0,
    again: PlayedAgain | None = None,
    group: Callable[[Mu], Sequence[Group]] | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Failures | None:
    """List the failures among the samples of a run, and write them into its folder.

    Some are played again to see what the agent does, by `again` if it is given, and with `seeds`
    each is tried again on so many fresh seeds; None tries `USUAL_SEEDS` on as
    many as is cheap. A file that is there is returned as it is where it
    has these, but for its groups. `group` says how the failures, (n, d), are grouped; without it
    they stay as they were, or wide gaps part them. An evaluator with a store gives it up.

    Returns:
        What failures.json holds; None where no sample fooled.
    """
    folder, samples = run.folder, run.samples
    threshold = run.target.fooling_threshold
    rows = np.flatnonzero(samples.fooled(threshold))[:_MOST_LISTED]
    if not len(rows):
        return None
    mu, space = opened.parameters.validate(samples.mu[rows]), opened.parameters
    known = _known(run, rows)
    if group is not None:
        groups = group(mu)
    elif known is not None:
        groups = _groups_of(known, rows)
    else:
        groups = [Group(part, words(mu[part], space)) for part in distinct(mu, space)]
    if known is not None and (not seeds or (known.seeds == seeds and known.tried == len(rows))):
        failures = _grouped(known, rows, groups)
        if failures != known:
            write_model(folder / FAILURES_FILE, failures)
        return failures
    protocol = run.settings.experiment.protocol
    evaluations = protocol.budget + protocol.samples
    # where failures are left out, so are the samples behind the last one
    worlds = _worlds(samples, rows, _MOST_LISTED)
    tried, fresh = len(rows), None
    if seeds is None:
        seeds, paid = USUAL_SEEDS, int(_SHARE_AGAIN * evaluations) // USUAL_SEEDS
        tried = min(tried, paid)
        seeds = seeds if tried == len(rows) or tried >= _FEWEST_AGAIN else 0
    if seeds:
        own = [fresh_seeds(run.settings.seed, row, seeds) for row in rows[:tried].tolist()]
        opened.evaluator.expect(seeds * tried)
        store = folder / ELSEWHERE_FILE
        fresh = try_again(opened.evaluator, mu[:tried], own, threshold, store, on_scores)
    count = min(_PLAYED, max(_FEWEST_PLAYED, int(_PLAYED_SHARE * evaluations)))
    passing = np.flatnonzero(~samples.fooled(threshold) & ~samples.invalid)[:count]
    again = again or PlayedAgain(opened.application)
    behaviours = again.play(samples[rows[:count]])
    compared = any(
        isinstance(value, Plain) for behaviour in behaviours for value in behaviour.data.values()
    )
    passes = again.play(samples[passing]) if compared else ()
    confirmed = None if fresh is None else int(fresh.fails.sum())
    before = worlds if tried == len(rows) else _worlds(samples, rows, tried)
    failures = Failures(
        fooled=Rate.of(len(rows), worlds),
        seeds=seeds,
        confirmed=None if confirmed is None else Rate.of(confirmed, tried),
        confirmed_afr=None if confirmed is None else Rate.of(confirmed, before),
        behaviours=Behaviours.of(behaviours, passes),
        groups=(),
        failures=_listed(opened, samples, rows, fresh, behaviours),
    )
    failures = _grouped(failures, rows, groups)
    write_model(folder / FAILURES_FILE, failures)
    return failures


def _worlds(samples: Evaluations, rows: Indices, count: int) -> int:
    """Count the valid samples up to the failure in the row of that number, all without one."""
    return len((samples if len(rows) < count else samples[: int(rows[count - 1]) + 1]).valid)


def fresh_seeds(seed: int, sample: int, count: int) -> tuple[int, ...]:
    """Return the first fresh seeds of a sample in a run with this seed; more begin with these."""
    return tuple(evaluation_seeds(seed, "validation", sample * MOST_SEEDS, count))


class PlayedAgain:
    """Plays evaluations again to see what the agent does in them, each of them once."""

    def __init__(self, application: Application) -> None:
        self._application = application
        self._told: dict[tuple[bytes, int], Behaviour] = {}

    def play(self, worlds: Evaluations) -> tuple[Behaviour, ...]:
        """Say what the agent did in each evaluation; those that are new are played together.

        Returns none where the application does not tell it, or plays another episode each time;
        where it fails to, this warns.
        """
        keys = _keys(worlds)
        new = [
            row
            for key, row in {key: row for row, key in enumerate(keys)}.items()
            if key not in self._told
        ]
        told = _play(self._application, worlds[np.array(new, np.intp)])
        self._told.update(zip((keys[row] for row in new), told, strict=False))
        return tuple(self._told[key] for key in keys) if self._told.keys() >= {*keys} else ()


def _keys(worlds: Evaluations) -> list[tuple[bytes, int]]:
    return [(mu.tobytes(), seed) for mu, seed in zip(worlds.mu, worlds.seed.tolist(), strict=True)]


def _play(application: Application, samples: Evaluations) -> tuple[Behaviour, ...]:
    if not (len(samples) and application.tells_behaviour and application.repeatable):
        return ()
    try:
        played = tuple(application.behaviours(samples.mu, samples.seed.tolist()))
        sound = all(isinstance(behaviour, Behaviour) for behaviour in played)
        if len(played) != len(samples) or not sound:
            raise UserTypeError(f"expected {len(samples)} objects of Behaviour, got {played!r}")
    except Exception as error:  # a user's code, too, and must not cost the result
        reason = shown(f"{type(application).__name__}.behaviours: {described(error)}")
        warnings.warn(f"What the agent did is left out. {reason}", Notice, stacklevel=3)
        return ()
    return played


def _known(run: Run, rows: Indices) -> Failures | None:
    """Return the failures that were listed before, if they are those of these samples."""
    known = run.failures
    if known is None or sorted(failure.sample for failure in known.failures) != rows.tolist():
        return None
    return known


def _groups_of(known: Failures, rows: Indices) -> list[Group]:
    """Return the groups that were found before; each begins with its representative."""
    number = {failure.sample: failure.group for failure in known.failures}
    of = np.array([number[row] for row in rows.tolist()])
    groups = []
    for place, group in enumerate(known.groups, 1):
        inside = np.flatnonzero(of == place)
        middle_first = np.argsort(rows[inside] != group.representative, kind="stable")
        groups.append(Group(inside[middle_first], group.where, group.weakness))
    return groups


def _grouped(failures: Failures, rows: Indices, groups: Sequence[Group]) -> Failures:
    """Number the groups of failures: the largest first, and those in no weakness last."""
    last = any(group.weakness for group in groups)
    ordered = sorted(groups, key=lambda group: (last and not group.weakness, -len(group.rows)))
    number = {int(rows[i]): n for n, group in enumerate(ordered, 1) for i in group.rows}
    listed = (
        failure.model_copy(update={"group": number[failure.sample]})
        for failure in failures.failures
    )
    sized = (
        FailureGroup(
            failures=len(group.rows),
            representative=int(rows[group.rows[0]]),
            where=group.where,
            weakness=group.weakness,
        )
        for group in ordered
    )
    return failures.model_copy(update={"groups": tuple(sized), "failures": tuple(listed)})


def _listed(
    opened: OpenTarget,
    samples: Evaluations,
    rows: Indices,
    fresh: FreshScores | None,
    behaviours: Sequence[Behaviour],
) -> tuple[Failure, ...]:
    listed = []
    fooled, valid = ((), ()) if fresh is None else (fresh.fooled_seeds, fresh.valid_seeds)
    for i, row in enumerate(rows.tolist()):
        mu: Mu = samples.mu[row]
        listed.append(
            Failure(
                sample=row,
                mu=tuple(mu.tolist()),
                seed=int(samples.seed[row]),
                score=float(samples.score[row]),
                parameters=opened.parameters.describe(mu),
                group=1,
                fooled_seeds=None if i >= len(fooled) else int(fooled[i]),
                valid_seeds=None if i >= len(valid) else int(valid[i]),
                behaviour=shown(behaviours[i].text) if i < len(behaviours) else None,
            )
        )

    def order(failure: Failure) -> tuple[float, float, int]:
        untried = failure.valid_seeds is None
        certainty = 0.5 if untried else (failure.fooled_seeds or 0) / (failure.valid_seeds or 1)
        return -certainty, failure.score, failure.sample

    return tuple(sorted(listed, key=order))
