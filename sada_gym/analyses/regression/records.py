"""A suite in the forms of others: a record a test case, and SARIF for what code hosts show."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sada_gym.analyses.regression.suite import Case, Objective, Ranged, Suite
from sada_gym.foundations.files import Strict

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


class TestCaseRecord(Strict):
    """A world as a test case, with the fields that ISO 34505 asks for.

    Attributes:
        objective: Which weakness the failure belongs to; of a control, which it is like.
        inputs: The world's parameters, with units in the names.
        seeds: The evaluation seeds, which fix everything else.
        platform: The SHA-256 of agent and ranges, the application, versions of packages.
        frequency: The share of the seeds on which it failed.
    """

    identifier: str
    kind: Objective
    objective: str
    inputs: dict[str, float | str]
    seeds: tuple[int, ...]
    steps: str
    platform: dict[str, str]
    expected_result: str
    actual_result: str
    frequency: float


def records(suite: Suite) -> tuple[TestCaseRecord, ...]:
    """Return a record for each world of a suite."""
    item = suite.test_item
    ranges = json.dumps([ranged.model_dump() for ranged in suite.logical_scenario])
    platform = {
        "track": item.target.track,
        "agent": item.target.agent,
        "agent_sha256": (
            item.agent_file.sha256 if item.agent_file else item.target.application.fingerprint or ""
        ),
        "ranges_sha256": hashlib.sha256(ranges.encode()).hexdigest(),
        **item.packages,
    }
    steps = f"Make the world, and let the agent act to the end of the episode; {item.target.track}."
    return tuple(
        TestCaseRecord(
            identifier=case.id,
            kind=case.objective,
            objective=suite.groups[case.group - 1],
            inputs=_inputs(case, suite.logical_scenario),
            seeds=case.seeds,
            steps=steps,
            platform=platform,
            expected_result=suite.pass_criterion,
            actual_result=f"fooled on {case.fooled_seeds} of {len(case.seeds)} seeds",
            frequency=case.fooled_seeds / len(case.seeds),
        )
        for case in suite.test_cases
    )


def as_json(suite: Suite) -> bytes:
    """Write the records as JSON."""
    return _json([record.model_dump() for record in records(suite)])


def as_csv(suite: Suite) -> bytes:
    """Write the records as CSV: a column for each input and each part of the platform."""
    rows = []
    for record in records(suite):
        row = record.model_dump(exclude={"inputs", "platform"})
        row["seeds"] = " ".join(map(str, record.seeds))
        taken = {*row, *record.platform}
        inputs = {
            f"{name} (input)" if name in taken else name: value
            for name, value in record.inputs.items()
        }
        rows.append({**row, **inputs, **record.platform})
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def as_sarif(suite: Suite, file: Path | None = None) -> bytes:
    """Write the failures as SARIF 2.1.0: a rule for each weakness, a result for each failure.

    Code hosts show them beside a file, such as the agent's.
    """
    item, results, located = suite.test_item, [], {}
    if file is not None:
        place = {"physicalLocation": {"artifactLocation": {"uri": _uri(file)}}}
        located = {"locations": [place]}
    for case, record in zip(suite.test_cases, records(suite), strict=True):
        if case.objective != "failure":
            continue
        world = ", ".join(f"{name} {_short(value)}" for name, value in record.inputs.items())
        same = json.dumps([case.mu, case.seeds, item.target.track])
        results.append(
            {
                "ruleId": _rule(case.group),
                "ruleIndex": case.group - 1,
                "level": "error",
                "message": {"text": f"{case.id} {record.actual_result}: {world}"},
                **located,
                "partialFingerprints": {"world/v1": hashlib.sha256(same.encode()).hexdigest()},
            }
        )
    rules = [
        {"id": _rule(number), "shortDescription": {"text": f"{item.target} fails: {group}"}}
        for number, group in enumerate(suite.groups, 1)
    ]
    driver = {"name": "sada_gym", "version": item.packages.get("sada_gym", ""), "rules": rules}
    run = {"tool": {"driver": driver}, "results": results}
    return _json({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]})


def _uri(file: Path) -> str:
    """Return a file's URI, relative to the current folder, a repository's, where it lies there."""
    path = Path(os.path.abspath(file))
    inside = path.is_relative_to(Path.cwd())
    return quote(path.relative_to(Path.cwd()).as_posix()) if inside else path.as_uri()


def _rule(group: int) -> str:
    return f"F{group:02}"


def _inputs(case: Case, ranges: Sequence[Ranged]) -> dict[str, float | str]:
    inputs: dict[str, float | str] = {}
    for ranged in ranges:
        value, parameter = case.concrete_scenario[ranged.name], ranged.parameter()
        name = f"{parameter.label} ({ranged.unit})" if ranged.unit else parameter.label
        name = ranged.name if name in inputs else name
        told = parameter.text(value).removeprefix(f"{parameter.label} ")
        if ranged.whole:
            inputs[name] = round(min(max(value, ranged.low + 0.5), ranged.high - 0.5))
        else:
            inputs[name] = told if ranged.choices else value
    return inputs


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _json(content: Any) -> bytes:
    return (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode()
