"""Results of studies that go on where they stopped: a row of JSON each, written as it comes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read_rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def mean_f1(rows: list[dict[str, Any]]) -> dict[str, dict[int, float]]:
    """Return the mean F1 over seeds by adversary and budget; a row of a failed run has no F1."""
    found: dict[str, dict[int, list[float]]] = {}
    for row in sorted(rows, key=lambda row: int(row["budget"])):
        if "f1" in row:
            found.setdefault(row["adversary"], {}).setdefault(row["budget"], []).append(row["f1"])
    return {
        adversary: {budget: sum(f1s) / len(f1s) for budget, f1s in of_budget.items()}
        for adversary, of_budget in found.items()
    }


def add_row(path: Path, row: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
    print(path.stem, row, flush=True)
