"""Do samples that were learnt in the rasteriser fool the same detector in Cycles?

    python -m studies.virtual_to_cycles --budget 2000 --out runs/virtual-to-cycles

Three adversaries attack the COCO detector in the rasteriser, on two classes; 100 samples of each
are then drawn by Blender. The paper photographed a toy instead: 21 % of its samples fooled there,
and 4.3 % of random views. OUT gets a folder a run, and the table as JSON and Markdown. A second
call goes on where the first stopped, in the middle of a run as well.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from sada_gym import attack
from sada_gym.analyses.rescore import Comparison, confirm
from sada_gym.foundations.files import write_file
from studies.without_hits import without_hits

TRACK = "SADA-DetectionCoco-{}-v0"
ADVERSARIES = ("random", "bbgan", "level-set")


def confirmed(track: str, adversary: str, given: argparse.Namespace) -> Comparison:
    """Attack a track in the rasteriser, and show the samples to the detector in Cycles."""
    folder = given.out / f"{track}-{adversary}"
    attack(
        track,
        adversary,
        budget=0 if adversary == "random" else given.budget,
        samples=given.samples,
        options=without_hits(adversary),
        out=folder,
        resume=True,
        pictures=False,
    )
    found = confirm(folder, {"renderer": given.renderer}, workers=given.workers).comparison
    print(f"{track}, {adversary}: {found.afr_here} here, {found.afr_there} there", flush=True)
    return found


def table(rows: Sequence[Comparison]) -> Iterator[str]:
    """Yield the table as Markdown."""
    yield (
        "| track | adversary | AFR in the rasteriser | AFR in Cycles | of those that fool here, "
        "fool there | of the others, fool there | rank correlation |"
    )
    yield "| --- " * 7 + "|"
    for row in rows:
        rank = "-" if row.rank_correlation is None else f"{row.rank_correlation:.2f}"
        rates = (str(rate or "-") for rate in (row.afr_here, row.afr_there, row.both, row.new))
        yield f"| {row.here.track} | {row.adversary} | {' | '.join(rates)} | {rank} |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--classes", nargs="*", default=["Car", "Motorbike"])
    parser.add_argument("--adversaries", nargs="*", default=list(ADVERSARIES))
    parser.add_argument("--budget", type=int, default=2_000)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--renderer", default="blender")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/virtual-to-cycles"))
    given = parser.parse_args(arguments)
    rows = [
        confirmed(TRACK.format(suffix), adversary, given)
        for suffix in given.classes
        for adversary in given.adversaries
    ]
    dumped = [row.model_dump(mode="json") for row in rows]
    write_file(given.out / "cycles.json", json.dumps(dumped, indent=2).encode())
    text = "\n".join(table(rows))
    write_file(given.out / "cycles.md", f"{text}\n".encode())
    print(text)


if __name__ == "__main__":
    main()
