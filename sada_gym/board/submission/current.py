"""The experiments that an entry may have results of, as they are now."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache

from sada_gym import agents
from sada_gym.adversaries.base import Adversary
from sada_gym.board.benchmark.suite import TABLES
from sada_gym.errors import MissingExtra, UserError, check_known
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import Experiment
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.cards import cards

PAPER_BUDGETS = "paper-budgets"
RULES = tuple(TABLES)
"""The rules for the budget; each has the name of the table that it is from."""


def board_tracks() -> dict[str, str]:
    """Return the tracks on which an entry may have results: the application's name by id.

    Applications without tracks, such as SADA-Analytic, take part by their general id.
    """
    return {track: card.name for card in cards() for track in card.board_tracks}


@lru_cache(maxsize=256)
def current_target(track: str, agent: str | None = None) -> OpenTarget:
    """Describe a track with a shipped agent, empty without any; it is closed again.

    None takes the track's first agent. A track or an agent that there is not is a UserError.
    """
    tracks = board_tracks()
    check_known("track", [track], tuple(tracks))
    shipped = agents.names(tracks[track])
    if agent is None:
        agent = next(iter(shipped), "")
    if shipped:
        check_known(f"agent on {track}", [agent], tuple(shipped))
    elif agent:
        raise UserError(f"Expected no agent's name on {track}, which has none; got {agent!r}.")
    with OpenTarget.of(track, agent=agent) as target:
        _ = target.fooling_set  # read while it is open
        return target


def current_experiment(
    track: str, agent: str | None, rule: str, adversary: AdversarySpec
) -> Experiment:
    """Return the experiment as the benchmark would make it now.

    The options of an adversary that is not ours stay as they are. An unknown name, or an option
    that one of ours refuses, is a UserError.
    """
    target = current_target(track, agent)
    solver: Adversary | None = None
    check_known("rule", [rule], RULES)
    if adversary.is_ours:
        adversary = adversary.resolve()
        try:
            with suppress(MissingExtra):
                solver = adversary.make(target.dimension, seed=0, ideal_set=target.ideal_set)
        except TypeError as error:
            raise UserError(
                f"Expected options that {adversary.name} takes, got others: {error}."
            ) from error
    elif adversary.resolved is None:
        adversary = adversary.model_copy(update={"resolved": adversary.options})
    return Experiment(
        target=target.target,
        adversary=adversary,
        protocol=TABLES[rule].protocol(target, adversary, solver),
    )
