"""What an attack evaluates after its samples: the diagnosis, and failures tried again."""

from __future__ import annotations

import json
from pathlib import Path


def spent_after_samples(folder: Path) -> tuple[int, int]:
    """Return the fresh evaluations of a run's diagnosis, and those of failures tried again."""
    fresh: int = json.loads((folder / "diagnosis.json").read_text())["fresh"]
    failures = json.loads((folder / "failures.json").read_text())
    tried: int = (failures["confirmed"] or {"samples": 0})["samples"]
    return fresh, tried * failures["seeds"]
