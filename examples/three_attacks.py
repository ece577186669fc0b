"""Attack the car detector in three ways with equally many queries, and compare what they find.

    python examples/three_attacks.py

It takes about a minute; `make attack` runs it. A stopped run goes on, a finished one is not
repeated. `--out DIR` takes another folder.
"""

import argparse
import sys
from collections.abc import Mapping

from sada_gym import Run, attack
from sada_gym.errors import UserError

BUDGET = 2_000
ATTACKS = {
    "random": "random worlds",
    "bbgan": "BBGAN, from the paper",
    "level-set": "level-set, the default",
}


def table(runs: Mapping[str, Run]) -> str:
    """Compare runs, a line each."""
    lines = ["adversary                new worlds that fool the detector   variety"]
    for adversary, run in runs.items():
        result, samples = run.result, run.settings.experiment.protocol.samples
        fools = f"{100 * result.afr:.0f} %, {result.fooled} of {samples}"
        variety = f"{100 * result.relative_coverage:.0f} %"
        lines.append(f"{ATTACKS[adversary]:24} {fools:>33} {variety:>9}")
    return "\n".join(lines)


def main(out: str) -> None:
    """Attack in each way, compare, and say where the pictures are."""
    print(f"Three attacks on the car detector, {BUDGET:,} queries each; results go to {out}")
    runs = {}
    for adversary, name in ATTACKS.items():
        print(f"Attacking: {name}", flush=True)
        is_last = adversary == "level-set"  # the others' weaknesses would be shown nowhere
        runs[adversary] = attack(
            "SADA-Detection-Car-v0",
            adversary,
            budget=BUDGET,
            out=f"{out}/{adversary}",
            resume=True,
            diagnose=is_last,
            html=is_last,
        )
    default = runs["level-set"]
    result = default.result
    rate, low, high = (f"{100 * share:.0f}" for share in (result.afr, *result.afr_interval_95))
    print(
        f"\n{table(runs)}\n\n"
        "Variety: how many of all known kinds of failures are among these worlds;\n"
        "perfect samples reach 100 %.\n\n"
        f"The default's attack fooling rate (AFR): {rate} % ({low} to {high}, 95 % interval)\n"
        f"where it fails   {default.folder}/report.html\n"
        f"pictures         {default.folder}/fooled.png, also in random and bbgan"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Compare three attacks on the car detector.")
    parser.add_argument("--out", default="runs/attack", help="the folder for the results")
    try:
        main(parser.parse_args().out)
    except UserError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit("Stopped. The same command goes on.")
