"""What differs between two records, in words."""

from __future__ import annotations

from collections.abc import Mapping

from sada_gym.errors import UserError


def differences(old: Mapping[str, object], new: Mapping[str, object]) -> list[str]:
    """Name what differs between two records, down to single entries."""
    changes = []
    for name in sorted({*old, *new}):
        before, now = old.get(name), new.get(name)
        if isinstance(before, Mapping) and isinstance(now, Mapping):
            changes += [f"{name}.{change}" for change in differences(before, now)]
        elif before != now:
            changes.append(f"{name} was {before!r} and is {now!r}")
    return changes


def check_same_record(
    expected: str,
    old: Mapping[str, object],
    new: Mapping[str, object],
    fix: str = "Give the same ones, or name another folder.",
) -> None:
    """Raise a ValueError that names every entry in which two records differ, if any does."""
    changes = differences(old, new)
    if changes:
        raise UserError(f"Expected {expected}, got others: {'; '.join(changes)}. {fix}")
