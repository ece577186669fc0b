"""Samples of finished runs, scored in other worlds: do attacks carry over, are they confirmed?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import Self

from sada_gym import agents
from sada_gym.analyses.mapping import map_samples
from sada_gym.analyses.ordinary import ORDINARY_SEEDS, ORDINARY_WORLDS, ordinary_worlds
from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, UserTypeError, check_integer, check_keywords
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.stored import InParts, OnScores, stored_scores
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.names import card_of, check_spelling
from sada_gym.experiment.target import OpenTarget, Target
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.cards import fetchable
from sada_gym.foundations.files import Strict, as_path, read_model, write_model
from sada_gym.foundations.ids import names_file
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Mu, ParameterSpace
from sada_gym.run import Run
from sada_gym.run.folder import ELSEWHERE_FILE, write_samples
from sada_gym.run.run import as_run, as_runs

CONFIRMED_FILE = "confirmed.json"
_FEWEST_RANKS = 3


class Comparison(Strict):
    """The rates of a run's samples in the run's own environment (here) and in another one (there).

    Attributes:
        run: The run's folder.
        adversary: The adversary's name in reports.
        seed: The run's seed.
        here: What the run attacked.
        there: Where the samples are scored again.
        keywords: The keywords given for `there`.
        afr_here: The attack fooling rate of these samples here; `afr_there`: the rate there.
        both: The share that also fools there, of the samples that fooled here; None if none did.
        new: The share that fools there, of the samples that did not fool here; None if all did.
        rank_correlation: Spearman's, of the scores here and there; None for fewer than three
            samples, or if all scores on one side are equal.
        invalid: How many samples are left out because their world is invalid here or there.
        clipped: By parameter, how many samples lie outside its range there; they are moved to the
            nearest end of the range.
        ordinary: How often worlds of the run's ordinary use (without a density, uniform worlds)
            fail there; None from `rescore` and `confirm`.
    """

    run: str
    adversary: str
    seed: int
    here: Target
    there: Target
    keywords: dict[str, Any]
    afr_here: Rate
    afr_there: Rate
    both: Rate | None
    new: Rate | None
    rank_correlation: float | None
    invalid: int = 0
    clipped: dict[str, int]
    ordinary: Rate | None = None


class Transfers(Strict):
    """The result of `transfer`: a comparison for each run and each target."""

    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True, eq=False)
class Rescored:
    """The result of `rescore` and `confirm`.

    Attributes:
        comparison: The rates here and there.
        scores: The samples as mu of the other environment, with their scores and seeds there.
    """

    comparison: Comparison
    scores: Evaluations


def rescore(
    run: Run | str | Path,
    target: str | Application | None = None,
    *,
    agent: str | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    samples: int | None = None,
    seed: int | None = None,
    workers: int | Workers = 1,
    application: Application | str | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Rescored:
    """Score the samples of one finished run in one other environment; see `transfer`.

    Args:
        run: A run, or its folder.
        target: An id, a TOML file or an application; None takes what the run attacked, with
            another agent, other keywords or other seeds.
        agent: See `transfer`.
        env_kwargs: Keywords for the id.
        samples: The number of samples to score, the first ones; None takes all.
        seed: The seed of new evaluation seeds; None takes those of the samples.
        workers: See :class:`~sada_gym.Workers`.
        application: What the run attacked, if the run does not record it, see :meth:`.Run.open`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: As `transfer` does.
    """
    scored = _scored(
        [as_run(run)],
        [] if target is None else _listed([target]),
        agent,
        env_kwargs,
        samples=samples,
        seed=seed,
        workers=workers,
        application=application,
        on_scores=on_scores,
    )
    return scored[0]


def transfer(
    runs: Run | str | Path | Sequence[Run | str | Path],
    to: str | Application | Sequence[str | Application] = (),
    *,
    agent: str | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    samples: int | None = None,
    seed: int | None = None,
    workers: int | Workers = 1,
    application: Application | str | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Transfers:
    """Score the samples of finished runs on other tracks, or against other agents.

    A sample keeps its physical values, so its mu changes if a range differs. A value outside a
    range is moved to the nearest end and counted. As many ordinary worlds, at most 100, are scored
    too: if most of these fail as well, failing samples say little. The scores are kept in
    `elsewhere.sqlite` in the run's folder, so that a stopped call continues where it was.

    Args:
        runs: Runs, or their folders.
        to: Ids, TOML files or applications. If empty, each run's own track is used, with another
            agent or other keywords.
        agent: The agent there. By default it is the run's agent if that is shipped for the track,
            otherwise the track's default agent.
        env_kwargs: Keywords for the ids.
        samples: The number of samples of each run to score, the first ones; None takes all.
        seed: The seed of new evaluation seeds; None takes those of the samples, so that nothing
            else differs in worlds of the same application.
        workers: See :class:`~sada_gym.Workers`.
        application: What the runs attacked, if they do not record it, see :meth:`.Run.open`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: If an argument is bad, a run is not finished or cannot be opened as it was, or
            the parameters there have other names, units or choices.
    """
    scored = _scored(
        as_runs(runs),
        _listed(to),
        agent,
        env_kwargs,
        samples=samples,
        seed=seed,
        workers=workers,
        application=application,
        on_scores=on_scores,
        ordinary=ORDINARY_WORLDS,
    )
    return Transfers(comparisons=tuple(one.comparison for one in scored))


def confirm(
    run: Run | str | Path,
    env_kwargs: Mapping[str, Any],
    *,
    samples: int | None = None,
    out: str | Path | None = None,
    workers: int | Workers = 1,
    on_scores: OnScores = lambda *_: None,
) -> Rescored:
    """Score a run's samples again on its own track with other keywords, such as a slow renderer.

    Each sample keeps its seed. The run's folder gets `confirmed.json` and `confirmed.npz`, which
    has the mu, score and seed of each sample.

    Args:
        run: A run of an id, or its folder.
        env_kwargs: The keywords to change, such as `{"renderer": "blender"}`; others stay the same.
        samples: The number of samples to score, the first ones; None takes all.
        out: Another path for confirmed.json; the arrays are written beside it.
        workers: See :class:`~sada_gym.Workers`.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: As `transfer` does, or if nothing changes.
        FileError: If the file holds a confirmation with other keywords.
    """
    attacked = as_run(run)
    path = attacked.folder / CONFIRMED_FILE if out is None else _json_path(out)
    check_keywords("env_kwargs", env_kwargs)
    keywords = dict(env_kwargs)
    if not keywords:
        raise UserError(
            "Expected keywords that change the world, got none. Name one, such as --env-kwargs "
            "renderer=blender."
        )

    def check(task: _Samples) -> None:
        if task.there.target.application == attacked.target.application:
            raise UserError(
                f"Expected keywords that change the world, got {keywords}, with which it is the "
                f"one that the run in {attacked.folder} attacked. Give others."
            )
        if path.exists() and read_model(path, Comparison).there != task.there.target:
            raise FileError(
                f"Expected {path} to hold a confirmation with {keywords}, got one with "
                f"{read_model(path, Comparison).keywords}. Name another file by --out (out=)."
            )

    (scored,) = _scored(
        [attacked],
        [],
        keywords.get("agent"),
        {name: value for name, value in keywords.items() if name != "agent"},
        samples=samples,
        seed=None,
        workers=workers,
        application=None,
        on_scores=on_scores,
        check=check,
    )
    told = scored.comparison.model_copy(update={"keywords": keywords})
    write_samples(path.with_suffix(".npz"), scored.scores)
    write_model(path, told)
    return Rescored(told, scored.scores)


def _scored(
    runs: Sequence[Run],
    targets: Sequence[str | Application],
    agent: str | None,
    env_kwargs: Mapping[str, Any] | None,
    *,
    samples: int | None,
    seed: int | None,
    workers: int | Workers,
    application: Application | str | None,
    on_scores: OnScores,
    check: Callable[[_Samples], object] = lambda _: None,
    ordinary: int = 0,
) -> list[Rescored]:
    """Score each run's samples in each target; what is opened for one serves all runs."""
    keywords = {} if env_kwargs is None else dict(env_kwargs)
    check_keywords("env_kwargs", keywords)
    _check_agent(agent, keywords, targets)
    if not (targets or keywords or agent or seed is not None):
        raise UserError(
            "Expected a track, an agent, keywords or a seed to try the samples with, got none. "
            "Name them by --to, --agent, --env-kwargs or --seed (to=, agent=, env_kwargs=, seed=)."
        )
    for named in targets:
        check_spelling(named, None, {**keywords, **({} if agent is None else {"agent": agent})})
    with ExitStack() as stack:
        opened: dict[object, OpenTarget] = {}
        tasks: list[_Samples] = []
        for run in runs:
            chosen, seeds, space, usual = _chosen(run, samples, seed, application, ordinary)
            for target in targets or (None,):
                with_agent = agent or _own_agent(run.target, target)
                key = (run.folder if target is None else target, with_agent)
                if key not in opened:
                    there = _open(run, target, keywords, with_agent, application, workers)
                    opened[key] = stack.enter_context(there)
                tasks.append(_Samples.of(run, chosen, seeds, space, opened[key], keywords, usual))
                check(tasks[-1])
        for there in opened.values():
            there.evaluator.expect(sum(len(task.mu) for task in tasks if task.there is there))
        in_parts = InParts(on_scores, sum(len(task.mu) for task in tasks))
        return [task.scored(in_parts) for task in tasks]


def _chosen(
    run: Run,
    count: int | None,
    seed: int | None,
    application: Application | str | None,
    ordinary: int,
) -> tuple[Evaluations, list[int], ParameterSpace, Mu]:
    """Return samples of a run, all seeds elsewhere, the space, and ordinary worlds."""
    samples = run.samples
    if count is not None:
        check_integer("samples", count, 1, len(samples))
        samples = samples[:count]
    seeds: list[int] = samples.seed.tolist()
    if seed is not None:
        check_integer("seed", seed, 0)
        seeds = evaluation_seeds(seed, "validation", 0, len(samples))
    first, most = run.settings.seed if seed is None else seed, min(ordinary, len(samples))
    seeds = seeds + evaluation_seeds(first, "validation", ORDINARY_SEEDS, most)
    with run.open(application) as opened:
        usual = ordinary_worlds(opened.application, most, run.settings.seed)
        return samples, seeds, opened.parameters, usual


@dataclass(frozen=True, eq=False)
class _Samples:
    """The samples of a run, as mu of the world in which they are to be scored."""

    run: Run
    samples: Evaluations
    seeds: list[int]
    there: OpenTarget
    keywords: dict[str, Any]
    mu: Mu
    clipped: dict[str, int]

    @classmethod
    def of(
        cls,
        run: Run,
        samples: Evaluations,
        seeds: list[int],
        space: ParameterSpace,
        there: OpenTarget,
        keywords: dict[str, Any],
        usual: Mu,
    ) -> Self:
        names = str(run.folder), str(there.target)
        mu, clipped = map_samples(samples.mu, space, there.parameters, *names)
        usual, _ = map_samples(usual, space, there.parameters, *names)
        return cls(run, samples, seeds, there, keywords, np.concatenate([mu, usual]), clipped)

    def scored(self, on_scores: OnScores) -> Rescored:
        run, there = self.run, self.there
        store = run.folder / ELSEWHERE_FILE
        scored = stored_scores(there.evaluator, self.mu, self.seeds, store, on_scores)
        scored, usual = scored[: len(self.samples)], scored[len(self.samples) :].valid
        failing = int(usual.fooled(there.target.fooling_threshold).sum())
        valid = ~(self.samples.invalid | scored.invalid)
        if not valid.any():
            raise UserError(
                f"Expected samples of {run.folder} whose worlds are valid there as well, got none "
                f"in {there.target}. Choose another one."
            )
        old, new = self.samples[valid], scored[valid]
        here = old.fooled(run.target.fooling_threshold)
        fooled = new.fooled(there.target.fooling_threshold)
        known, others = int(here.sum()), int((~here).sum())
        comparison = Comparison(
            run=str(run.folder),
            adversary=run.settings.label,
            seed=run.settings.seed,
            here=run.target,
            there=there.target,
            keywords=self.keywords,
            afr_here=Rate.of(known, len(here)),
            afr_there=Rate.of(int(fooled.sum()), len(here)),
            both=Rate.of(int((here & fooled).sum()), known) if known else None,
            new=Rate.of(int((~here & fooled).sum()), others) if others else None,
            rank_correlation=_rank_correlation(old.score, new.score),
            invalid=int((~valid).sum()),
            clipped=self.clipped,
            ordinary=Rate.of(failing, len(usual)) if len(usual) else None,
        )
        return Rescored(comparison, scored)


def _rank_correlation(here: Floats, there: Floats) -> float | None:
    from scipy.stats import spearmanr

    if len(here) < _FEWEST_RANKS or np.ptp(here) == 0.0 or np.ptp(there) == 0.0:
        return None
    return float(spearmanr(here, there).statistic)


def _open(
    run: Run,
    target: str | Application | None,
    keywords: Mapping[str, Any],
    agent: str | None,
    application: Application | str | None,
    workers: int | Workers,
) -> OpenTarget:
    if target is not None:
        return OpenTarget.of(target, keywords, agent=agent, workers=workers)
    if run.given.by == "id":
        return run.open_changed(keywords, agent=agent, workers=workers)
    if keywords or agent not in (None, run.target.agent):
        raise UserError(
            f"Expected a run of an id, whose keywords can change, got that of {run.folder} in an "
            "application of yours. Describe the other world in another file, and name that "
            "by `sada-gym transfer --to FILE.toml`."
        )
    return run.open(application, workers=workers)


def _own_agent(here: Target, target: str | Application | None) -> str | None:
    """Return the run's agent where it is shipped for another track; None for that track's own."""
    if target is None:
        return here.agent
    if not isinstance(target, str) or names_file(target):
        return None
    card = card_of(target)
    known = () if card is None else (*agents.names(card.name), *fetchable(card.name))
    return here.agent if here.agent in known else None


def _check_agent(
    agent: Any, keywords: Mapping[str, Any], targets: Sequence[str | Application]
) -> None:
    if agent is not None and not isinstance(agent, str):
        raise UserTypeError(f"Expected an agent's name or file, got {agent!r}.")
    if agent is not None and "agent" in keywords:
        raise UserError("Expected the agent once, got it by agent and by env_kwargs.")
    if agent is not None and any(isinstance(target, Application) for target in targets):
        raise UserTypeError(
            f"Expected an agent only with ids, got {agent!r} with an Application. Give it to the "
            "application itself."
        )


def _listed(given: Any) -> list[Any]:
    items = [given] if isinstance(given, str | Path | Application) else given
    if not isinstance(items, Sequence) or not all(
        isinstance(item, str | Path | Application) for item in items
    ):
        raise UserTypeError(f"Expected an id or an Application or a list of them, got {given!r}.")
    return [str(item) if isinstance(item, Path) else item for item in items]


def _json_path(out: str | Path) -> Path:
    path = as_path(out, "the confirmation")
    if path.suffix != ".json":
        raise UserError(f"Expected a file that ends in .json, got {path}.")
    return path
