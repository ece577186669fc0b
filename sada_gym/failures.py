"""The failures among a run's samples: what the agent does, how sure and how different they are."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sada_gym.application import Application
from sada_gym.arrays import Indices
from sada_gym.behaviour import Behaviour, Behaviours, Plain
from sada_gym.errors import FileError, Notice, UserTypeError, check_integer, described
from sada_gym.evaluation.stored import FreshScores, OnScores, try_again
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.finished import check_samples, open_target, read_run
from sada_gym.experiment.folder import ELSEWHERE_FILE
from sada_gym.experiment.record import RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.files import OneLine, Strict, as_path, read_model, shown, write_model
from sada_gym.measures.groups import distinct, words
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Mu

FAILURES_FILE = "failures.json"
MOST_SEEDS = 1_000
_MOST_LISTED = 1_000
_PLAYED, _FEWEST_PLAYED, _PLAYED_SHARE = 10, 3, 0.02
"""Failures that are played again to see what the agent does: at most so many, and this share of
the run's evaluations."""


class Failure(Strict):
    """A test sample that fooled the agent.

    Attributes:
        sample: Its row in samples.npz.
        parameters: Its physical values by name.
        group: The number of its distinct failure, from 1.
        fooled_seeds: With how many fresh seeds it fooled again, out of `valid_seeds` with which the
            world is valid; None where it was not tried again.
        behaviour: What the agent did; None where it was not played again.
    """

    sample: int
    mu: tuple[float, ...]
    seed: int
    score: float
    parameters: dict[str, float]
    group: int
    fooled_seeds: int | None = None
    valid_seeds: int | None = None
    behaviour: OneLine | None = None

    @property
    def fails_again(self) -> bool:
        """Whether it fooled with more than half of its valid fresh seeds."""
        return 2 * (self.fooled_seeds or 0) > (self.valid_seeds or 0)


class FailureGroup(Strict):
    """A distinct failure: samples of one weakness that no wide gap parts.

    Attributes:
        failures: The number of samples in it.
        representative: The sample in its middle.
        where: What its worlds share, in words.
        weakness: The number of its weakness in the diagnosis, from 1; 0 where the samples lie in
            none of these, and None where there is no diagnosis.
    """

    failures: int
    representative: int
    where: OneLine
    weakness: int | None = None


@dataclass(frozen=True, eq=False)
class Group:
    """The rows of failures that are one `FailureGroup`, its middle first."""

    rows: Indices
    where: str
    weakness: int | None = None


class Failures(Strict):
    """The contents of failures.json.

    Attributes:
        fooled: How many of the valid samples fooled.
        seeds: The number of fresh seeds on which each failure was tried again; 0 for none.
        confirmed: How many of the failures fooled again on most of their fresh seeds; None without
            such seeds.
        confirmed_afr: The same over all samples.
        behaviours: What the agent did in some of them; None where nothing is told.
        groups: The distinct failures, the largest first; those in no weakness come last.
        failures: The failures, the surest first, then those with the lowest score. Of very many
            only the first samples are here, and count above.
    """

    version: Literal[1] = 1
    fooled: Rate
    seeds: int = 0
    confirmed: Rate | None = None
    confirmed_afr: Rate | None = None
    behaviours: Behaviours | None
    groups: tuple[FailureGroup, ...]
    failures: tuple[Failure, ...]

    @property
    def apart(self) -> tuple[FailureGroup, ...]:
        """The groups, but for the one in no weakness where others lie in one."""
        return tuple(group for group in self.groups if group.weakness) or self.groups

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the name and the text of each finding, as the summary of a run has them."""
        if self.behaviours is not None:
            yield "what it does", self.behaviours.sentence
        if len(self.groups) > 1:
            sizes = [group.failures for group in self.apart]
            listed = ", ".join(map(str, sizes[:4])) + (", ..." if len(sizes) > 4 else "")
            text = f"{len(sizes):,} group{'s' * (len(sizes) > 1)}, of {listed} samples"
            others = sum(group.failures for group in self.groups) - sum(sizes)
            yield "distinct failures", f"{text}; {others:,} in no weakness" if others else text
        if self.confirmed is not None and self.confirmed_afr is not None:
            again = f"{self.confirmed.fooled} of {self.confirmed.samples} failures fail again"
            on = "a fresh seed" if self.seeds == 1 else f"most of {self.seeds} fresh seeds"
            yield "confirmed", f"{again} on {on}: a confirmed rate of {self.confirmed_afr}"


def read_failures(run: str | Path) -> Failures | None:
    """Read the failures of a run; None where its folder has no such file.

    Raises:
        FileError: If the file is damaged, or of another version.
    """
    path = as_path(run, "a run's folder") / FAILURES_FILE
    return read_model(path, Failures) if path.is_file() else None


def confirm_failures(
    run: str | Path,
    seeds: int = 3,
    *,
    application: Application | str | None = None,
    workers: int = 1,
    on_scores: OnScores = lambda *_: None,
) -> Failures | None:
    """Try each failure of a finished run again on fresh seeds, and write failures.json anew.

    The scores are kept in the run's folder: a call that was stopped goes on where it was, and one
    with more seeds asks only for these.

    Args:
        run: The folder that `attack` wrote.
        seeds: The number of fresh seeds for each failure; 0 tries none.
        application: What the run attacked, where it cannot say it, see `replay`.
        workers: 1 evaluates in this process, more in as many others.
        on_scores: See `OnScores`.

    Returns:
        What failures.json holds; None where no sample fooled.

    Raises:
        UserError: If an argument is bad, or the run is not finished or cannot be opened as it was.
    """
    check_seeds(seeds)
    folder = as_path(run, "a run's folder")
    settings, samples = read_run(folder)
    call = f"sada_gym.failures.confirm_failures({str(folder)!r}, application=YOURS)"
    with open_target(settings, folder, application, call=call, workers=workers) as opened:
        check_samples(samples, opened)
        return list_failures(opened, settings, samples, folder, seeds=seeds, on_scores=on_scores)


def check_seeds(seeds: object, name: str = "seeds") -> None:
    """Raise a UserError unless a number of fresh seeds is an int from 0 to `MOST_SEEDS`."""
    check_integer(name, seeds, 0, MOST_SEEDS)


def list_failures(
    opened: OpenTarget,
    settings: RunSettings,
    samples: Evaluations,
    folder: Path,
    *,
    seeds: int = 0,
    again: PlayedAgain | None = None,
    group: Callable[[Mu], Sequence[Group]] | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Failures | None:
    """List the failures among the samples of a run, and write them into its folder.

    Some are played again to see what the agent does, by `again` if it is given, and with `seeds`
    each is tried again on so many fresh seeds. A file that is there is returned as it is where it
    has these, but for its groups. `group` says how the failures, (n, d), are grouped; without it
    they stay as they were, or wide gaps part them. An evaluator with a store gives it up.

    Returns:
        What failures.json holds; None where no sample fooled.
    """
    threshold = settings.experiment.target.fooling_threshold
    rows = np.flatnonzero(samples.fooled(threshold))[:_MOST_LISTED]
    if not len(rows):
        return None
    mu, space = opened.parameters.validate(samples.mu[rows]), opened.parameters
    known = _known(folder, rows)
    if group is not None:
        groups = group(mu)
    elif known is not None:
        groups = _groups_of(known, rows)
    else:
        groups = [Group(part, words(mu[part], space)) for part in distinct(mu, space)]
    if known is not None and (not seeds or known.seeds == seeds):
        failures = _grouped(known, rows, groups)
        if failures != known:
            write_model(folder / FAILURES_FILE, failures)
        return failures
    # where failures are left out, so are the samples behind the last one that is listed
    tried = samples if len(rows) < _MOST_LISTED else samples[: int(rows[-1]) + 1]
    worlds = len(tried.valid)
    fresh = None
    if seeds:
        own = [fresh_seeds(settings.seed, row, seeds) for row in rows.tolist()]
        opened.evaluator.expect(seeds * len(rows))
        store = folder / ELSEWHERE_FILE
        fresh = try_again(opened.evaluator, mu, own, threshold, store, on_scores)
    protocol = settings.experiment.protocol
    most = int(_PLAYED_SHARE * (protocol.budget + protocol.samples))
    count = min(_PLAYED, max(_FEWEST_PLAYED, most))
    passing = np.flatnonzero(~samples.fooled(threshold) & ~samples.invalid)[:count]
    again = again or PlayedAgain(opened.application)
    behaviours = again.play(samples[rows[:count]])
    compared = any(
        isinstance(value, Plain) for behaviour in behaviours for value in behaviour.data.values()
    )
    passes = again.play(samples[passing]) if compared else ()
    confirmed = None if fresh is None else int(fresh.fails.sum())
    failures = Failures(
        fooled=Rate.of(len(rows), worlds),
        seeds=seeds,
        confirmed=None if confirmed is None else Rate.of(confirmed, len(rows)),
        confirmed_afr=None if confirmed is None else Rate.of(confirmed, worlds),
        behaviours=Behaviours.of(behaviours, passes),
        groups=(),
        failures=_listed(opened, samples, rows, fresh, behaviours),
    )
    failures = _grouped(failures, rows, groups)
    write_model(folder / FAILURES_FILE, failures)
    return failures


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


def listed_before(folder: Path) -> Failures | None:
    """Return the failures that a run's folder lists; None where its file is missing or damaged."""
    with suppress(FileError):  # a damaged file is made anew
        return read_failures(folder)
    return None


def _known(folder: Path, rows: Indices) -> Failures | None:
    """Return the failures that were listed before, if they are those of these samples."""
    known = listed_before(folder)
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
                fooled_seeds=None if fresh is None else int(fresh.fooled_seeds[i]),
                valid_seeds=None if fresh is None else int(fresh.valid_seeds[i]),
                behaviour=shown(behaviours[i].text) if i < len(behaviours) else None,
            )
        )

    def order(failure: Failure) -> tuple[float, float, int]:
        certainty = (failure.fooled_seeds or 0) / (failure.valid_seeds or 1)
        return -certainty, failure.score, failure.sample

    return tuple(sorted(listed, key=order))
