"""`level-set` as it was before it tried hits, for studies of many hours that were made with it."""

from __future__ import annotations

from typing import Any


def without_hits(adversary: str) -> dict[str, Any]:
    """Return the options of an adversary, by name, in such a study."""
    return {"trial": 0.0} if adversary == "level-set" else {}
