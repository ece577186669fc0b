"""A regression's result for other programs: JUnit XML, and Markdown for pull requests."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter

from sada_gym.analyses.regression.compare import BROKEN, Change
from sada_gym.analyses.regression.regress import CaseResult, Regression
from sada_gym.analyses.regression.suite import ORDINARY
from sada_gym.foundations.files import shown
from sada_gym.measures.diagnosis.grouping import NO_WEAKNESS

_SHOWN = 20
_COLUMNS: tuple[Change, ...] = ("fixed", "still fails", "regressed", "new failure", "still passes")
_VERBS = {"passed": "passes", "failed": "fails", "inconclusive": "cannot be judged"}


def junit(result: Regression) -> bytes:
    """Write a result as JUnit XML: a test case a world.

    A world that regressed or newly fails is a failure. One that still fails is skipped, for it is
    known, and so is one that is invalid.
    """
    changes = Counter(world.change for world in result.worlds)
    failures = sum(changes[change] for change in BROKEN)
    skipped = changes["still fails"] + changes["not comparable"]
    counts = {"tests": len(result.worlds), "failures": failures, "skipped": skipped, "errors": 0}
    attributes = {
        "name": f"{result.track} {result.agent}",
        **{k: str(v) for k, v in counts.items()},
    }
    root = ET.Element("testsuites", attributes)
    suite = ET.SubElement(root, "testsuite", {**attributes, "time": "0"})
    about = {
        "decision": result.decision.status,
        "reason": result.decision.reason,
        "suite": shown(result.suite),
        "baseline": result.baseline or "expected results",
    }
    _properties(suite, about)
    for world in result.worlds:
        _test_case(suite, result, world)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _test_case(suite: ET.Element, result: Regression, world: CaseResult) -> None:
    case = world.case
    group = result.groups[case.group - 1]
    element = ET.SubElement(
        suite,
        "testcase",
        {
            "classname": f"{result.track}.{_place(case.group, group)}",
            "name": f"{case.id}: {group}",
            "time": "0",
        },
    )
    seeds = ", ".join(map(str, case.seeds))
    values = {name: f"{value:.6g}" for name, value in case.concrete_scenario.items()}
    _properties(element, {**values, "change": world.change, "seeds": seeds})
    message = f"{world.change}: {_outcome(world)}"
    if world.change in BROKEN:
        place = ", ".join(f"{name}={value}" for name, value in values.items())
        ET.SubElement(
            element, "failure", {"message": message, "type": world.change}
        ).text = f"{place}; seeds {seeds}; mu {list(case.mu)}"
    elif world.change in ("still fails", "not comparable"):
        ET.SubElement(element, "skipped", {"message": message})


def _place(number: int, where: str) -> str:
    return where if where in (NO_WEAKNESS, ORDINARY) else f"weakness {number}"


def _properties(parent: ET.Element, values: dict[str, str]) -> None:
    properties = ET.SubElement(parent, "properties")
    for name, value in values.items():
        ET.SubElement(properties, "property", {"name": name, "value": value})


def _outcome(world: CaseResult) -> str:
    if world.invalid:
        return f"{world.invalid} of {len(world.scores)} seeds break the world"
    return f"Q = {', '.join(f'{score:.3g}' for score in world.scores)}"


def markdown(result: Regression) -> str:
    """Write a result as Markdown: the decision, a table by weakness, what regressed."""
    decision = result.decision
    lines = [
        f"### {_plain(result.track)}: {_plain(result.agent)} {_VERBS[decision.status]}",
        "",
        f"{_plain(decision.reason)} Compared with {_plain(result.compared_with)}.",
        "",
        f"| where | worlds | {' | '.join(_COLUMNS)} |",
        f"| --- | --- {'| --- ' * len(_COLUMNS)}|",
    ]
    for number, group in enumerate(result.groups, 1):
        inside = Counter(world.change for world in result.worlds if world.case.group == number)
        cells = [
            f"{number}. {_plain(group)}",
            str(inside.total()),
            *(str(inside[column]) for column in _COLUMNS),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    broken = [world for world in result.worlds if world.change in BROKEN]
    if broken:
        lines += [
            "",
            "| world | | parameters | seeds | Q |",
            "| --- | --- | --- | --- | --- |",
        ]
    for world in broken[:_SHOWN]:
        case = world.case
        place = ", ".join(f"{_plain(n)} {v:.4g}" for n, v in case.concrete_scenario.items())
        seeds = ", ".join(map(str, case.seeds))
        scores = ", ".join(f"{score:.3g}" for score in world.scores)
        lines.append(f"| {_plain(case.id)} | {world.change} | {place} | {seeds} | {scores} |")
    if len(broken) > _SHOWN:
        lines += ["", f"{len(broken) - _SHOWN} more worlds fail that passed before."]
    incomparable = sum(world.change == "not comparable" for world in result.worlds)
    if incomparable:
        lines += ["", f"{incomparable} worlds are invalid, now or before, and do not count."]
    if result.failing is not None:
        lines += ["", f"The worlds that fail: {_plain(result.failing)}."]
    if result.differences:
        lines += ["", "Different from when the suite was exported:", ""]
        lines += [f"- {_plain(change)}" for change in result.differences]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Escape what Markdown or HTML would obey."""
    for sign, escaped in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "\\|")):
        text = text.replace(sign, escaped)
    for sign in "`*_[]":
        text = text.replace(sign, f"\\{sign}")
    return text
