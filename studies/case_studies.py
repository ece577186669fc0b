"""The paper's two case studies: five scenarios, two sets of parameters, and what carries over.

    python -m studies.case_studies --budget 1000 --out runs/case-studies

Each scenario is one model in front of the COCO detector: a simple car and a simple motorbike, which
our procedures made, and a detailed car and two detailed motorbikes. Case 1 has the parameters
`viewpoint`, case 2 `occlusion`. Every adversary is trained in each scenario, and its samples are
scored in others, as in the paper's appendix. OUT gets a folder a run, and the two tables as JSON
and Markdown; a second call goes on where the first stopped.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from sada_gym import attack
from sada_gym.analyses.rescore import Comparison, Rate, transfer
from sada_gym.foundations.files import write_file
from sada_gym.measures.rates import FoolingRate, lead_interval
from studies.without_hits import without_hits

ID = "SADA-DetectionCoco-v0"
SCENARIOS: Mapping[int, Mapping[str, str]] = {
    1: {"object_class": "car", "shapes": "benchmark", "only": "car/saloon-0"},
    2: {"object_class": "car", "shapes": "textured", "only": "sweethome3d/ford-focus"},
    3: {"object_class": "motorbike", "shapes": "benchmark", "only": "motorbike/naked-0"},
    4: {"object_class": "motorbike", "shapes": "textured", "only": "sweethome3d/yamaha-r6"},
    5: {"object_class": "motorbike", "shapes": "textured", "only": "sweethome3d/scooter"},
}
DETAILED = (2, 4, 5)
PAIRS = ((1, 2), (2, 1), (3, 4), (3, 5), (4, 3), (5, 3))
CASES = {"viewpoint": "Case 1: viewpoint", "occlusion": "Case 2: occlusion"}
THEIRS: Mapping[str, Mapping[tuple[int, int], tuple[float, float, float, float]]] = {
    "viewpoint": {
        (1, 2): (96.4, 70.4, 0.0, 26.0),
        (2, 1): (88.8, 26.0, 90.4, 70.4),
        (3, 4): (92.0, 53.2, 0.8, 10.4),
        (3, 5): (92.0, 53.2, 3.2, 13.2),
        (4, 3): (90.8, 10.4, 95.2, 53.2),
        (5, 3): (16.8, 13.2, 64.8, 53.2),
    },
    "occlusion": {
        (1, 2): (96.8, 58.0, 36.0, 32.4),
        (2, 1): (94.8, 32.4, 77.2, 58.0),
        (3, 4): (95.6, 52.0, 90.8, 37.2),
        (3, 5): (95.6, 52.0, 94.0, 39.6),
        (4, 3): (99.2, 37.2, 100.0, 52.0),
        (5, 3): (100.0, 39.6, 100.0, 52.0),
    },
}
"""The paper's two tables: BBGAN and random in a scenario, and after the transfer to another."""


def run(case: str, scenario: int, adversary: str, budget: int, samples: int, out: Path) -> Path:
    """Attack one scenario, or go on with that; returns the run's folder."""
    folder = out / f"{case}-{scenario}-{adversary}"
    attack(
        ID,
        adversary,
        env_kwargs={**SCENARIOS[scenario], "parameters": case},
        budget=0 if adversary == "random" else budget,
        samples=samples,
        options=without_hits(adversary),
        out=folder,
        resume=True,
        pictures=False,
    )
    return folder


def tried(
    case: str, adversary: str, given: argparse.Namespace
) -> dict[tuple[int, int], Comparison]:
    """Train an adversary in all scenarios, and score its samples in the pairs of the paper."""
    runs = {
        scenario: run(case, scenario, adversary, given.budget, given.samples, given.out)
        for scenario in SCENARIOS
    }
    found = {}
    for here, there in PAIRS:
        keywords = {**SCENARIOS[there], "parameters": case}
        (found[here, there],) = transfer(runs[here], ID, env_kwargs=keywords).comparisons
        print(f"{case}, {adversary}: {here} to {there}, {found[here, there].afr_there}", flush=True)
    return found


def table(case: str, of: Mapping[str, Mapping[tuple[int, int], Comparison]]) -> Iterator[str]:
    """Yield a case's table as Markdown: ours with intervals, and the paper's."""
    yield f"### {CASES[case]}"
    yield ""
    names = [name for name in of if name != "random"]
    heads = [f"{name} {place}" for name in (*names, "random") for place in ("here", "there")]
    yield f"| from | to | {' | '.join(heads)} | paper: BBGAN, random here | there |"
    yield "| --- " * (4 + len(heads)) + "|"
    for pair in PAIRS:
        rates = [
            str(rate)
            for name in (*names, "random")
            for rate in (of[name][pair].afr_here, of[name][pair].afr_there)
        ]
        here, random_here, there, random_there = THEIRS[case][pair]
        theirs = f"{here}, {random_here} | {there}, {random_there}"
        yield f"| {pair[0]} | {pair[1]} | {' | '.join(rates)} | {theirs} |"
    yield ""


def leads(of: Mapping[str, Mapping[tuple[int, int], Comparison]]) -> Iterator[str]:
    """Yield by how much samples learnt elsewhere fool more often than random worlds do there."""
    yield "| adversary | from | to | lead over random worlds there, points | learnt on |"
    yield "| --- | --- | --- | --- | --- |"
    for name in of:
        for pair in PAIRS if name != "random" else ():
            ours, theirs = (_rate(of[which][pair].afr_there) for which in (name, "random"))
            low, high = lead_interval(ours, theirs)
            kind = "detailed" if pair[0] in DETAILED else "simple"
            lead = 100 * (ours.rate - theirs.rate)
            interval = f"{lead:+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"
            yield f"| {name} | {pair[0]} | {pair[1]} | {interval} | {kind} |"
    yield ""


def _rate(rate: Rate) -> FoolingRate:
    return FoolingRate(rate.fooled, rate.samples, rate.rate, *rate.interval_95)


def write(out: Path, case: str, of: Mapping[str, Mapping[tuple[int, int], Comparison]]) -> None:
    """Write a case's comparisons as JSON and its tables as Markdown."""
    rows = [
        {"case": case, "from": here, "to": there, **row.model_dump(mode="json")}
        for pairs in of.values()
        for (here, there), row in pairs.items()
    ]
    write_file(out / f"{case}.json", json.dumps(rows, indent=2).encode())
    write_file(out / f"{case}.md", "\n".join([*table(case, of), *leads(of)]).encode())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=1_000)
    parser.add_argument("--samples", type=int, default=250)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--adversaries", nargs="*", default=["bbgan", "level-set"])
    parser.add_argument("--out", type=Path, default=Path("runs/case-studies"))
    given = parser.parse_args(arguments)
    for case in given.cases:
        of = {name: tried(case, name, given) for name in (*given.adversaries, "random")}
        write(given.out, case, of)
        print((given.out / f"{case}.md").read_text())


if __name__ == "__main__":
    main()
