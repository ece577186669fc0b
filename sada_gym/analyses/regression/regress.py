"""Runs a regression suite with another agent, and compares it world by world."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.agents.agent_files import SUFFIXES
from sada_gym.analyses.estimation.estimate import estimate_open
from sada_gym.analyses.failures import PlayedAgain
from sada_gym.analyses.mapping import map_samples
from sada_gym.analyses.regression.compare import (
    FALSE_ALARM,
    Change,
    Decision,
    change_of,
    check_margin,
    combine,
    decide,
    decide_ordinary,
    demand,
    gate,
    verdict_of,
)
from sada_gym.analyses.regression.suite import ORDINARY, Case, Item, Suite, Verdict, read_suite
from sada_gym.application import Application
from sada_gym.envs.wrapped.toml import application_of
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.stored import InParts, OnScores, stored_scores
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.differences import differences
from sada_gym.experiment.packages import installed
from sada_gym.experiment.target import OpenTarget, Target
from sada_gym.foundations.behaviour import Behaviours
from sada_gym.foundations.files import OneLine, Strict, parse_toml, shown
from sada_gym.measures.likelihood import FailureEstimate

EXIT_CODES: Mapping[str, int] = {"passed": 0, "failed": 1, "inconclusive": 3}


class CaseResult(Strict):
    """The results in one world of the suite.

    Attributes:
        case: The world.
        before: `pass` or `fail`: the baseline's result, or the one that the suite expects; None if
            the world is invalid.
        now: The agent's result.
        change: One of fixed, regressed, new failure, still fails, still passes, not comparable.
        scores: The agent's scores, one for each seed.
        invalid: The number of seeds with which the world is invalid.
    """

    case: Case
    before: Verdict | None
    now: Verdict | None
    change: Change
    scores: tuple[float, ...]
    invalid: int = 0


class Regression(Strict):
    """The result of `regress`.

    Attributes:
        suite: The suite's file.
        suite_agent: The agent that the suite was exported from.
        agent: The agent that was tested.
        baseline: The agent it was compared with; None if with the results that the suite expects.
        decision: Whether the agent passed, and why.
        ordinary: The decision by the ordinary worlds alone, if any; `decision` includes it.
        likely: How likely a failure is in ordinary use, if `max_probability` was given.
        differences: What has changed since the suite was exported, such as versions.
        groups: What the worlds of each distinct failure have in common; last the ordinary worlds.
        worlds: The results in each world.
        failing: If the score has several requirements: which ones the agent fails now.
    """

    suite: str
    suite_agent: OneLine
    track: OneLine
    agent: OneLine
    baseline: OneLine | None
    decision: Decision
    ordinary: Decision | None
    likely: FailureEstimate | None = None
    differences: tuple[OneLine, ...]
    groups: tuple[OneLine, ...]
    worlds: tuple[CaseResult, ...]
    failing: OneLine | None = None

    @property
    def exit_code(self) -> int:
        """0 if the agent passed, 1 if it failed, 3 if the suite cannot tell."""
        return EXIT_CODES[self.decision.status]

    @property
    def compared_with(self) -> str:
        """The baseline, in words."""
        made = f" (made with {self.suite_agent})" if self.suite_agent else ""
        return f"what the suite expects{made}" if self.baseline is None else self.baseline

    def counts(self, *, ordinary: bool = False) -> dict[Change, int]:
        """Count the worlds, or only the ordinary ones, by their `change`, without zeros."""
        changes = [
            world.change
            for world in self.worlds
            if not ordinary or world.case.objective == "ordinary"
        ]
        return {change: changes.count(change) for change in dict.fromkeys(sorted(changes))}


def regress(
    suite: str | Path,
    agent: str | Path | Application,
    *,
    baseline: str | Path | Application | None = None,
    margin: float | None = None,
    max_failing: int | None = None,
    require_fixed: float | None = None,
    max_probability: float | None = None,
    budget: int = 2_000,
    workers: int | Workers = 1,
    store: str | Path | None = None,
    on_scores: OnScores = lambda *_: None,
) -> Regression:
    """Score an agent in the worlds of a suite, and compare it on the same worlds and seeds.

    Args:
        suite: The suite that `export` wrote: a .json file, or the folder of `suite.json`.
        agent: The agent to test: a shipped agent's name, an agent's file, a `tcp://` address or
            `module:object`, as the application takes it; or the application with the agent in it.
        baseline: Another agent to compare with, given like `agent`. None compares with the results
            that the suite expects.
        margin: The largest tolerated increase of the rate of failing worlds, see `decide`.
        max_failing: How many worlds may fail.
        require_fixed: The share of the known failures that must be fixed.
        max_probability: The largest tolerated probability of a failure in ordinary use: the 95 %
            interval must lie below it. The application must know its density.
        budget: The number of evaluations for that probability, see `estimate`.
        workers: See :class:`~sada_gym.Workers`.
        store: A file that keeps the scores, so that a stopped call continues where it was.
        on_scores: Called with the numbers of scores so far, in all, and from the store.

    Raises:
        UserError: If an argument is bad, the suite cannot be read, an agent does not fit, or the
            application's parameters have other names, units or choices.
    """
    path, content = read_suite(suite)
    check_margin(margin)
    if max_probability is not None and not 0.0 < max_probability < 1.0:
        raise UserError(
            f"Expected max_probability above 0 and below 1, such as 1e-3, got {max_probability}."
        )
    kept = None if store is None else Path(store)
    with ExitStack() as stack:
        agents = {"agent": agent, **({} if baseline is None else {"baseline": baseline})}
        opened = [
            stack.enter_context(_open(content.test_item, path, given, what, workers))
            for what, given in agents.items()
        ]
        total = len(opened) * sum(len(case.seeds) for case in content.cases)
        in_parts = InParts(on_scores, total)
        results = [_score(content, path, there, kept, in_parts) for there in opened]
        changed = _differences(content.test_item, path, opened[0])
        likely = None
        if max_probability is not None:
            likely = estimate_open(opened[:1], budget=budget, store=kept, on_scores=on_scores)
        failing = results[0].failing()
    now, before = results[0], results[1] if baseline is not None else None
    worlds = tuple(
        now.world(i, case.expected_result if before is None else before.verdicts[i], case)
        for i, case in enumerate(content.cases)
    )
    known = content.test_item.target.application if before is None else before.target.application
    changes = [world.change for world in worlds]
    chosen, drawn = np.split(np.array(changes, object), [len(content.test_cases)])
    is_old = known == content.test_item.target.application
    given: dict[str, Any] = {
        "margin": margin,
        "unchanged": known == now.target.application,
        "alarm": FALSE_ALARM / (1 + bool(len(drawn))),
    }
    unlucky = (content.unlucky_controls, content.unconfirmed) if is_old else (0, 0)
    decision = decide(chosen.tolist(), **given, unlucky=unlucky)
    decision = demand(
        decision, chosen.tolist(), max_failing=max_failing, require_fixed=require_fixed
    )
    ordinary = decide_ordinary(drawn.tolist(), **given) if len(drawn) else None
    decision = combine(decision, ordinary)
    if likely is not None and max_probability is not None:
        decision = gate(decision, likely, max_probability)
    return Regression(
        suite=str(path),
        suite_agent=shown(content.test_item.target.agent),
        track=shown(now.target.track),
        agent=shown(now.target.agent),
        baseline=None if before is None else shown(before.target.agent),
        decision=decision,
        ordinary=ordinary,
        likely=likely,
        differences=(*changed, *now.clipped),
        groups=(*content.groups, *([ORDINARY] if len(drawn) else [])),
        worlds=worlds,
        failing=failing,
    )


@dataclass(frozen=True, eq=False)
class _Tested:
    """What an agent got in the suite's worlds: evaluations (n seeds in all), by world."""

    opened: OpenTarget
    rows: list[slice]
    scored: Evaluations
    verdicts: list[Verdict | None]
    clipped: tuple[str, ...]

    @property
    def target(self) -> Target:
        return self.opened.target

    def failing(self) -> OneLine | None:
        """Say which of several requirements the agent fails, in the first bad seed of each world.

        None where the score has a single one, or no world fails.
        """
        application = self.opened.application
        failing = [
            rows for rows, now in zip(self.rows, self.verdicts, strict=True) if now == "fail"
        ]
        if not failing or not application.requirements:
            return None
        fooled = self.scored.fooled(application.fooling_threshold)
        bad = [rows.start + int(np.flatnonzero(fooled[rows])[0]) for rows in failing]
        told = Behaviours.of(PlayedAgain(application).play(self.scored[np.array(bad, np.intp)]))
        return None if told is None else shown(told.sentence)

    def world(self, i: int, before: Verdict | None, case: Case) -> CaseResult:
        rows = self.rows[i]
        return CaseResult(
            case=case,
            before=before,
            now=self.verdicts[i],
            change=change_of(case, before, self.verdicts[i]),
            scores=tuple(self.scored.score[rows].tolist()),
            invalid=int(self.scored.invalid[rows].sum()),
        )


def _score(
    suite: Suite, path: Path, there: OpenTarget, store: Path | None, on_scores: OnScores
) -> _Tested:
    mu, clipped = map_samples(
        suite.mu, suite.parameters, there.parameters, str(path), str(there.target)
    )
    counts = [len(case.seeds) for case in suite.cases]
    seeds = [seed for case in suite.cases for seed in case.seeds]
    there.evaluator.expect(len(seeds))
    repeated = np.repeat(mu, counts, axis=0)
    scored = stored_scores(there.evaluator, repeated, seeds, store, on_scores)
    fooled = scored.fooled(suite.test_item.target.fooling_threshold)
    ends = np.cumsum(counts).tolist()
    rows = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
    return _Tested(
        opened=there,
        rows=rows,
        scored=scored,
        verdicts=[verdict_of(fooled[part], scored.invalid[part]) for part in rows],
        clipped=tuple(
            f"{count} of {len(mu)} worlds lie outside the range of {name}, and are moved to its end"
            for name, count in clipped.items()
        ),
    )


def _open(
    item: Item, suite: Path, given: str | Path | Application, what: str, workers: int | Workers
) -> OpenTarget:
    if isinstance(given, Application):
        if given.name != item.target.application.name:
            raise UserError(
                f"Expected an application {shown(item.target.application.name)} as the {what}, as "
                f"in {suite}, got {shown(given.name)}. Export a suite of its own."
            )
        return OpenTarget.of(given, workers=workers)
    if not isinstance(given, str | Path) or not str(given):
        raise UserTypeError(
            f"Expected the {what} as a name, a file or an Application, got {given!r}."
        )
    if item.opened_by == "id":
        return OpenTarget.of(item.target.track, item.env_kwargs, agent=str(given), workers=workers)
    if item.opened_by == "python" or item.toml is None:
        raise UserError(
            f"Expected the {what} as an Application, because the one in {suite} was made in "
            f"Python, got {str(given)!r}. Call sada_gym.regress(SUITE, YOURS)."
        )
    folder = suite.parent / item.folder
    table = parse_toml(item.toml.encode(), suite)
    old, table["agent"] = table.get("agent"), _absolute(str(given), Path.cwd())
    if "agent_id" in table and not _same(table["agent"], _absolute(str(old), folder)):
        table["agent_id"] = _identity(table["agent"])  # the file's names the old agent
    application = application_of(table, folder / "application.toml")
    return OpenTarget.of(application, workers=workers)


def _absolute(agent: str, folder: Path) -> str:
    """Return an agent's file by its whole path, and anything else as it is."""
    path = os.path.expanduser(agent)
    is_file = Path(path).suffix.lower() in SUFFIXES or ":" not in agent
    return str(folder / path) if is_file else agent


def _same(agent: str, other: str) -> bool:
    return os.path.abspath(agent) == os.path.abspath(other)


def _identity(agent: str) -> str:
    """Name an agent, and its file by its content."""
    with suppress(OSError, ValueError):
        return f"{Path(agent).stem} {hashlib.sha256(Path(agent).read_bytes()).hexdigest()[:12]}"
    return agent


def _differences(item: Item, suite: Path, now: OpenTarget) -> tuple[str, ...]:
    """Say what is not as it was: the application, ranges, packages, and the agent's old file."""
    old, new = item.target.application.model_dump(), now.target.application.model_dump()
    for record in (old, new):
        del record["fingerprint"]  # of the agent, which may be another
    told = differences(old, new)
    if item.target.fooling_threshold != now.target.fooling_threshold:
        told.append(
            f"fooling_threshold is {now.target.fooling_threshold:g} and was "
            f"{item.target.fooling_threshold:g}, by which this suite is judged"
        )
    for name, before in item.packages.items():
        now_installed = installed(name)
        if now_installed != before:
            told.append(f"{name} was {before} and is {now_installed}")
    if item.agent_file is not None:
        path = suite.parent / item.agent_file.path
        with suppress(OSError):
            if hashlib.sha256(path.read_bytes()).hexdigest() != item.agent_file.sha256:
                told.append(f"{item.agent_file.path} is another file than when it was exported")
    return tuple(map(shown, told))
