"""Families of cases that run the same code: one member is tested fast, `make test-all` has all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from registry_cases import case_of

from sada_gym.foundations.cards import cards

SHIPPED = tuple(
    card.track_id(suffix) if (suffix := case_of(card.name).shipped_on or card.same_as) else card.id
    for card in cards()
)
"""One id of each application: its other tracks run the same code in other worlds."""

SECONDS_A_WORLD = ("SADA-DrivingMetaDrive-v0",)
"""Ids whose tests are never fast: a world takes seconds."""

MISSING = {
    env_id: card.missing if card.repeatable else "Its scores do not repeat to the last bit."
    for card in cards()
    for env_id in (card.id, *card.track_ids)
}
"""By id: why the tests of all ids cannot try it, such as a missing part; empty where they can."""


def family(members: Iterable[Any], *fast: Any) -> list[Any]:
    """Mark the members of a family as slow, except for those that stand for the others.

    Args:
        members: All parameters of a test.
        fast: Those that `make test` takes as well.
    """
    everyone = list(members)
    missing = [name for name in fast if name not in everyone]
    assert not missing, f"Expected {missing} among {everyone}."
    return [pytest.param(name, marks=_marks(name, fast)) for name in everyone]


def _marks(name: Any, fast: tuple[Any, ...]) -> list[pytest.MarkDecorator]:
    reason = MISSING.get(name, "") if isinstance(name, str) else ""
    skipped = [pytest.mark.skip(reason=reason)] if reason else []
    if name in SECONDS_A_WORLD:
        skipped.append(pytest.mark.long)
    return skipped if name in fast else [*skipped, pytest.mark.slow]
