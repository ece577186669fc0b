"""Families of cases that run the same code: one member is tested fast, `make test-all` has all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from registry_cases import case_of

from sada_gym.cards import cards

SHIPPED = tuple(
    card.track_id(suffix) if (suffix := case_of(card.name).shipped_on or card.same_as) else card.id
    for card in cards()
)
"""One id of each application: its other tracks run the same code in other worlds."""


def family(members: Iterable[Any], *fast: Any) -> list[Any]:
    """Mark the members of a family as slow, except for those that stand for the others.

    Args:
        members: All parameters of a test.
        fast: Those that `make test` takes as well.
    """
    everyone = list(members)
    missing = [name for name in fast if name not in everyone]
    assert not missing, f"Expected {missing} among {everyone}."
    return [pytest.param(name, marks=() if name in fast else pytest.mark.slow) for name in everyone]
