"""The identity of a result that is made today, which entries are checked against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from sada_gym import adversaries, agents
from sada_gym.adversaries.base import Adversary
from sada_gym.adversaries.random import Random
from sada_gym.benchmark.suite import TABLES, Table
from sada_gym.cards import cards
from sada_gym.errors import MissingExtra, UserError, check_known
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.assemble import RunTarget, make_adversary, make_settings, resolved_options
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import RunSettings
from sada_gym.measures.reference import load_reference
from sada_gym.parameters import Mu
from sada_gym.submission.models import Identity

PAPER_BUDGETS = "paper-budgets"
RULES = tuple(name for name, table in TABLES.items() if table.rule == name)
"""The rules for the budget; each has the name of the table that it is from."""


@dataclass(frozen=True, eq=False)
class Target:
    """A track with one of its agents, as they are today.

    Attributes:
        dimension: The number of semantic parameters.
        sample_size: M, the application's number of test samples.
        fooling_threshold: The agent is fooled where Q <= this.
        settings: The settings of a run of `random` on it.
        fooling_set: The points that coverage is measured by, (R, d); None where none are known.
        ideal_set: Other points known to fool, (R, d), which ideal samples are drawn from.
    """

    dimension: int
    sample_size: int
    fooling_threshold: float
    settings: RunSettings
    fooling_set: Mu | None
    ideal_set: Mu | None


def board_tracks() -> tuple[str, ...]:
    """Give the ids of the tracks on which an entry may have results.

    Applications without tracks, such as SADA-Analytic, take part by their general id.
    """
    return tuple(env_id for card in cards() for env_id in card.track_ids or (card.id,))


def application_of(track: str) -> str:
    """Give the name of a track's application.

    Raises:
        UserError: If there is no such track.
    """
    check_known("track", [track], board_tracks())
    return next(card.name for card in cards() if track in (card.track_ids or (card.id,)))


def default_agent(track: str) -> str:
    """Give the name of the agent that a track has by default; empty where it has none.

    Raises:
        UserError: If there is no such track.
    """
    return next(iter(agents.names(application_of(track))), "")


@lru_cache(maxsize=256)
def find_target(track: str, agent: str) -> Target:
    """Find a track with one of the agents that are shipped for it.

    Args:
        track: The environment's id.
        agent: The agent's name; empty where the application has none.

    Raises:
        UserError: If there is no such track, or no such agent is shipped.
    """
    shipped = agents.names(application_of(track))
    if shipped:
        check_known(f"agent on {track}", [agent], shipped)
    elif agent:
        raise UserError(f"Expected no agent's name on {track}, which has none; got {agent!r}.")
    application = make_application(track, **({"agent": agent} if agent in shipped[1:] else {}))
    try:
        target = RunTarget(track, application, load_reference(track, application))
        settings = make_settings(
            target, "random", Random, preset=None, options={}, budget=0, samples=1, seed=0
        )
        return Target(
            target.dimension,
            application.sample_size,
            float(application.fooling_threshold),
            settings,
            *target.split,
        )
    finally:
        application.close()


def find_rule(rule: str) -> Table:
    """Find the table whose budget a rule names.

    Raises:
        UserError: If there is no such rule.
    """
    check_known("rule", [rule], RULES)
    return TABLES[rule]


def is_ours(adversary: str) -> bool:
    """Say whether an adversary is one of ours; nothing else is imported for an entry."""
    return adversary == IDEAL or adversary in adversaries.names()


def today(
    track: str,
    agent: str,
    rule: str,
    adversary: str,
    preset: str | None,
    options: Mapping[str, Any],
    *,
    resolved: Mapping[str, Any] | None = None,
) -> Identity:
    """Give the identity of a result that is made today, as the benchmark would make it.

    Args:
        track: The environment's id.
        agent: The agent's name; empty where the application has none.
        rule: The name of the rule for the budget.
        adversary: The adversary's registered name, or what its authors call it.
        preset: The named set of options that it starts from.
        options: Its other options.
        resolved: All options of an adversary that is not ours; None takes `options`.

    Raises:
        UserError: If one of them is unknown, or one of our adversaries refuses the options.
    """
    target, table = find_target(track, agent), find_rule(rule)
    budget_rule = table.budget_of.get(target.settings.application, table.budget)
    if is_ours(adversary):
        resolved = resolved_options(adversary, preset, options)
        solver = _make(adversary, target, preset, options)
    else:
        resolved, solver = dict(options if resolved is None else resolved), None
    if adversary == IDEAL:
        budget = 0
    elif solver is None:
        budget = budget_rule.queries
    else:
        budget = budget_rule.of(adversary, solver)
    changes = {
        "adversary": adversary,
        "preset": preset,
        "options": dict(options),
        "resolved": resolved,
        "budget": budget,
        "samples": table.samples or target.sample_size,
    }
    settings = target.settings.model_copy(update=changes)
    return Identity.of(settings, rule, target.fooling_threshold)


def _make(
    adversary: str, target: Target, preset: str | None, options: Mapping[str, Any]
) -> Adversary | None:
    """Make one of our adversaries, which checks its options; None where a package is missing."""
    try:
        return make_adversary(
            adversary,
            target.dimension,
            seed=0,
            preset=preset,
            options=options,
            ideal_set=target.ideal_set,
        )
    except MissingExtra:
        return None
    except TypeError as error:
        raise UserError(f"Expected options that {adversary} takes, got others: {error}.") from error
