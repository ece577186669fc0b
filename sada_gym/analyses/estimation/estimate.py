"""The probability that an agent fails in ordinary use, of a run or an application."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.analyses.estimation.core import (
    Answers,
    Asked,
    Found,
    estimate_probability,
    ratio_of,
)
from sada_gym.analyses.estimation.table import TableDensity
from sada_gym.analyses.estimation.use import IndependentUse, JointUse
from sada_gym.application import Application
from sada_gym.densities import Density, WorldDensity
from sada_gym.errors import UserError, UserTypeError, check_integer, check_keywords, check_plain
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.oracle import MAX_QUERIES
from sada_gym.evaluation.stored import InParts, OnScores, stored_scores
from sada_gym.evaluations import evaluation_seeds, fools
from sada_gym.experiment.names import check_spelling
from sada_gym.experiment.record import FailureProbability
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.files import shown, write_file, write_model
from sada_gym.measures.diagnosis.grouping import by_weakness
from sada_gym.measures.likelihood import (
    DENSITY_FILE,
    ESTIMATE_FILE,
    ComparedAgent,
    FailureEstimate,
    RiskShare,
)
from sada_gym.parameters import Mu
from sada_gym.run import Run, load_run
from sada_gym.run.folder import ELSEWHERE_FILE, RESULT_FILE

_FEWEST, _SHOWN, _FARTHEST = 20, 20_000, 6.0
_FIRST_SEED = 2**24  # of the validation stream, whose first seeds have other purposes
_DRAWING_SEED = 67
_COUNTED = "plain draws of ordinary use"
_GUIDED = "importance sampling by a model of the scores, half of the draws plain"

Use = IndependentUse | JointUse


def estimate(
    run_or_application: Run | Application | str | Path,
    *,
    budget: int = 2_000,
    seed: int = 0,
    density: Any = None,
    env_kwargs: Mapping[str, Any] | None = None,
    application: Application | str | None = None,
    workers: int | Workers = 1,
    store: str | Path | None = None,
    beside: Run | Application | str | Path | None = None,
    per: int | None = None,
    unit: str | None = None,
    on_scores: OnScores = lambda *_: None,
) -> FailureEstimate:
    """Estimate the probability that the agent fails in ordinary use, over worlds and seeds.

    Nearly half of the budget is spent to learn where the agent fails; the queries of a run help.
    The rest is spent on fresh worlds: half are drawn from ordinary use (plain draws), half where
    failures are expected. It returns a :class:`.FailureEstimate`, unbiased wherever the agent
    fails. The interval assumes that no region of failures escaped all queries, see its `unseen`.

    For a run, its folder gets `estimate.json`, and `result.json` the probability as `in_use`. The
    folder also keeps the scores, so that a stopped call continues where it was. For an application
    or an id, give a `store` for that. The result depends only on the seed, not on the workers.

    Args:
        run_or_application: A run or its folder, an application, an id, or a TOML file.
        budget: The number of fresh evaluations; with fewer than 300 all of them are plain draws.
        seed: The seed of all draws.
        density: How likely worlds are in ordinary use: densities of parameters by name, as
            `nominal=` of a binding takes them (the other parameters are uniform); a joint density
            of all physical values that has `rvs` and `logpdf`, such as
            `scipy.stats.multivariate_normal(mean, covariance)`; or logged worlds, as (n, d)
            physical values or the path of a CSV file (a run's folder then gets `density.png`).
            By default it is the application's own.
        env_kwargs: Keywords of the environment, if an id is given.
        application: What the run attacked, if the run does not record it, see :meth:`.Run.open`.
        workers: See :class:`~sada_gym.Workers`.
        store: A file that keeps the scores. By default a run's folder keeps its scores.
        beside: Another agent. It is evaluated in the same worlds with the same seeds, which doubles
            the evaluations. Give its name or file (only if the first argument is an id or a run of
            an id), or a run, a run's folder, an application or a TOML file.
        per: The printed result also says how many of this many episodes fail.
        unit: What it then calls an episode, such as `flights`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: If an argument is bad, no density is known, or too many worlds are invalid.
    """
    check_integer("budget", budget, _FEWEST, MAX_QUERIES)
    check_integer("seed", seed, 0)
    check_keywords("env_kwargs", {} if env_kwargs is None else env_kwargs)
    check_integer("per", 1 if per is None else per, 1)
    check_plain("the unit", unit or "")
    run = _as_run(run_or_application)
    with ExitStack() as stack:
        if run is not None:
            if env_kwargs:
                raise UserError("Expected keywords only with an id, got some with a run.")
            opened = stack.enter_context(run.open(application, workers=workers))
            store = run.folder / ELSEWHERE_FILE if store is None else store
        else:
            assert not isinstance(run_or_application, Run)
            named = run_or_application
            environment = named if isinstance(named, Application) else str(named)
            check_spelling(environment, None, dict(env_kwargs or {}))
            opened = stack.enter_context(OpenTarget.of(environment, env_kwargs, workers=workers))
        both = [opened]
        if beside is not None:
            first = run_or_application if run is None else run
            other = _open_beside(beside, first, env_kwargs, workers)
            both.append(stack.enter_context(other))
        given = {"budget": budget, "seed": seed, "density": density, "store": store}
        result = estimate_open(both, run, **given, per=per, unit=unit, on_scores=on_scores)
    if run is not None:
        write_model(run.folder / ESTIMATE_FILE, result)
        in_use = FailureProbability(
            probability=result.probability,
            interval_95=result.interval,
            density=result.density,
            held=result.held,
            worlds=result.drawn,
            worth=result.effective / result.probability if result.probability else result.drawn,
        )
        told = run.result.model_copy(update={"in_use": None if result.refused else in_use})
        write_model(run.folder / RESULT_FILE, told)
    return result


def estimate_open(
    opened: Sequence[OpenTarget],
    run: Run | None = None,
    *,
    budget: int,
    seed: int = 0,
    density: Any = None,
    store: str | Path | None = None,
    per: int | None = None,
    unit: str | None = None,
    on_scores: OnScores = lambda *_: None,
) -> FailureEstimate:
    """Estimate of an agent, and maybe of a second one beside it, what `estimate` does."""
    first = opened[0].application
    for one in opened:
        one.evaluator.expect(budget)
    rng = np.random.default_rng((seed, _DRAWING_SEED))
    use = _use(first, density, rng)
    asking = _Asking(opened, use, budget, seed, None if store is None else Path(store), on_scores)
    threshold = float(first.fooling_threshold) if len(opened) == 1 else 0.0
    known = None if run is None else _known(run, use, first.fooling_threshold, threshold)
    found = estimate_probability(use, asking, threshold, budget, rng, known)
    each = [found.counted(answers) for answers in asking.last]
    shares = () if run is None else _shares(run, opened[0], use.mu(found.z), each[0])
    if run is not None and isinstance(use, JointUse) and use.table is not None:
        from sada_gym.analyses.plots.density import marginals

        drawn = use.table.rvs(_SHOWN, np.random.default_rng(0))
        picture = marginals(first.parameters, use.table.rows, drawn)
        write_file(run.folder / DENSITY_FILE, picture)
    compared = None
    if len(opened) > 1:
        ratio, interval = ratio_of(*each)
        compared = ComparedAgent(
            agent=shown(opened[1].target.agent or str(opened[1].target)),
            probability=each[1].probability,
            interval=each[1].interval,
            ratio=ratio,
            ratio_interval=interval,
            refused=each[1].refused,
        )
    counted, queries = each[0], asking.used * len(opened)
    valid = asking.last[0].valid
    plain = int(valid[: counted.plain].sum())
    return FailureEstimate(
        probability=counted.probability,
        interval=counted.interval,
        queries=queries,
        method=_GUIDED if counted.learnt else _COUNTED,
        refused=counted.refused,
        held=use.held,
        drawn=int(valid.sum()),
        failures=int(counted.failed.sum()),
        plain=plain,
        plain_failures=int(counted.failed[: counted.plain].sum()),
        effective=counted.effective,
        unseen=1.0 - 0.05 ** (1.0 / max(plain, 1)),
        shares=tuple(shares),
        density=use.data,
        seed=seed,
        to_halve=(3 if counted.failed.any() else 1) * queries,
        beside=compared,
        per=per,
        unit=unit,
    )


def _open_beside(
    beside: Any, named: Any, env_kwargs: Mapping[str, Any] | None, workers: int | Workers
) -> OpenTarget:
    other = _as_run(beside)
    if other is not None:
        return other.open(workers=workers)
    if isinstance(beside, Application):
        return OpenTarget.of(beside, workers=workers)
    if str(beside).endswith(".toml"):
        return OpenTarget.of(str(beside), workers=workers)
    if isinstance(named, Run) and named.given.by == "id":
        return named.open_changed({}, agent=str(beside), workers=workers)
    if isinstance(named, Run | Application) or str(named).endswith(".toml"):
        raise UserError(
            f"Expected a run, an Application or a TOML file with the other agent, got {beside!r}, "
            "which only an id can take. Describe it in a file of its own."
        )
    return OpenTarget.of(str(named), env_kwargs, agent=str(beside), workers=workers)


class _Asking:
    """Scores worlds of ordinary use, each with a seed of its own, and counts them.

    Of several agents a world counts as failed where any fails; `last` holds each one's answers.
    """

    def __init__(
        self,
        opened: Sequence[OpenTarget],
        use: Use,
        budget: int,
        seed: int,
        store: Path | None,
        on_scores: OnScores,
    ) -> None:
        self._evaluators, self._use, self._seed = [one.evaluator for one in opened], use, seed
        self._store = store
        spaces = [one.parameters.parameters for one in opened]
        if spaces[0] != spaces[-1]:
            raise UserError(
                f"Expected the same parameters and ranges of both agents, got those of "
                f"{opened[0].target} and of {opened[-1].target}. Make them alike."
            )
        self._in_parts = InParts(on_scores, budget * len(opened))
        self.used = 0
        self.last: list[Answers] = []

    def __call__(self, z: Floats, plain: Bools) -> Answers:
        """Score worlds at points, (n, d); of the plain ones, (n,), too many must not be invalid."""
        seeds = evaluation_seeds(self._seed, "validation", _FIRST_SEED + self.used, len(z))
        self.used += len(z)
        found = []
        for evaluator in self._evaluators:
            application = evaluator.application
            assert application is not None
            mu = application.parameters.validate(self._use.mu(z))
            # one store serves all agents in turn
            scored = stored_scores(evaluator, mu, seeds, self._store, self._in_parts, plain)
            failed = fools(scored.score, application.fooling_threshold)
            found.append((application, Answers(scored.score, failed, ~scored.invalid)))
        valid = np.all([answers.valid for _, answers in found], axis=0)
        self.last = [Answers(a.score, a.failed & valid, valid) for _, a in found]
        if len(found) == 1:
            return self.last[0]
        depth = [a.score - application.fooling_threshold for application, a in found]
        failed = np.any([answers.failed for answers in self.last], axis=0)
        return Answers(np.min(depth, axis=0), failed, valid)


def _as_run(given: Any) -> Run | None:
    if isinstance(given, Run):
        return given
    if not isinstance(given, Application | str | os.PathLike):
        raise UserTypeError(
            f"Expected a run, an Application, an environment's id or a TOML file, got {given!r}."
        )
    if isinstance(given, Application) or not Path(given).is_dir():
        return None
    return load_run(Path(given))


def _use(application: Application, density: Any, rng: np.random.Generator) -> Use:
    space, permits = application.parameters, application.permits
    if density is None:
        density = application.density
    if density is None:
        raise UserError(
            f"Expected a density of ordinary use, got none: {application.name} does not say how "
            "likely its worlds are. Give densities by nominal= of the parameters, or by density= "
            f'(--density): {space.names[0]}={{"normal": [mean, sd]}}.'
        )
    if isinstance(density, Mapping):
        unknown = [name for name in density if name not in space.names]
        if unknown:
            raise UserError(
                f"Expected densities of {', '.join(space.names)}, got one of {unknown[0]!r}."
            )
        given = {
            name: data if isinstance(data, Density) else Density(data)
            for name, data in density.items()
        }
        density = WorldDensity(space, given)
    if isinstance(density, WorldDensity):
        return IndependentUse(density, permits, rng)
    if isinstance(density, str | Path | list | np.ndarray):
        density = TableDensity(space, density)
    return JointUse(space, density, permits, rng)


def _known(run: Run, use: Use, threshold: float, zero: float) -> Asked | None:
    """Return the queries of a run, as far as they lie near ordinary use."""
    queries = run.queries
    if queries is None or not len(queries):
        return None
    z = use.points(queries.mu)
    near = np.asarray((np.abs(z) < _FARTHEST).all(axis=1))
    queries = queries[near]
    if not len(queries):
        return None
    score = queries.score + (zero - threshold)
    return z[near], Answers(score, queries.fooled(threshold), ~queries.invalid)


def _shares(run: Run, opened: OpenTarget, mu: Mu, found: Found) -> Sequence[RiskShare]:
    diagnosis = run.diagnosis
    rows = np.flatnonzero(found.failed)
    total = found.terms.sum()
    if diagnosis is None or not diagnosis.weaknesses or not total:
        return ()
    terms = found.terms[rows] / total
    groups = by_weakness(diagnosis.weaknesses, opened.parameters, mu[rows])
    shares = [
        RiskShare(
            number=group.weakness or 0, text=group.where, share=float(terms[group.rows].sum())
        )
        for group in groups
    ]
    return sorted(shares, key=lambda share: -share.share)
