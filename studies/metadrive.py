"""MetaDrive's drivers: the rule that ranges have to pass, what others do in the same worlds.

    python -m studies.metadrive rates --out FOLDER
    python -m studies.metadrive tables --out FOLDER

`rates` lets each driver drive in 200 nominal and 400 uniform worlds, the same for all, or in the
first `--most` of them, and keeps what became of each (some minutes for each driver and kind); what
is there already stays. `tables`
prints how often they fail, what happens, whom the worlds fool that fool the expert, and what
fails with which parameter. In brackets: 95 % intervals.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from sada_gym.envs.metadrive.agent.idm import CarefulDriver
from studies.shares import share

DRIVERS = ("metadrive-expert", "metadrive-ppo", "metadrive-idm", "UN R157")
WORLDS = {"nominal": 200, "uniform": 400}
EACH = 20
SEED = 0


def application(driver: str) -> Application:
    """Return MetaDrive with a driver."""
    agent = CarefulDriver() if driver == "UN R157" else driver
    return make_application("SADA-DrivingMetaDrive-v0", agent=agent)


def worlds(kind: str, application: Application) -> np.ndarray:
    """Return the mu of a kind of worlds; their seeds are 0, 1 and so on."""
    count, d = WORLDS[kind], len(application.parameters)
    if kind == "nominal":
        return np.tile(application.nominal, (count, 1))
    return np.random.default_rng(SEED).uniform(-1.0, 1.0, (count, d)).astype(np.float32)


def drive(driver: str, kind: str, file: Path, most: int) -> None:
    """Let a driver drive in the first worlds of a kind; a line of the file holds one of them."""
    done = len(file.read_text().splitlines()) if file.exists() else 0
    opened = application(driver)
    mu = worlds(kind, opened)[:most]
    for first in range(done, len(mu), EACH):
        seeds = range(first, min(first + EACH, len(mu)))
        outcomes = opened.evaluate(mu[first : seeds.stop], seeds)
        rows = [
            {"score": float(score), "fooled": bool(fooled), **info}
            for score, fooled, info in zip(
                outcomes.score, outcomes.fooled, outcomes.infos, strict=True
            )
        ]
        keys = ("score", "fooled", "ending", "route_done", "after_s", "speed_km_h")
        with file.open("a") as opened_file:
            opened_file.writelines(
                json.dumps({key: row[key] for key in keys}) + "\n" for row in rows
            )


def tables(out: Path) -> None:
    """Print the tables of the page."""
    told = {
        (driver, kind): [json.loads(line) for line in file.read_text().splitlines()]
        for driver in DRIVERS
        for kind in WORLDS
        if (file := _file(out, driver, kind)).exists()
    }
    fooled = {key: np.array([row["fooled"] for row in rows]) for key, rows in told.items()}
    for (driver, kind), rows in told.items():
        ends = Counter(row["ending"] for row in rows)
        words = ", ".join(f"{end} {n / len(rows):.1%}" for end, n in ends.most_common())
        print(f"| {driver} | {kind} | {share(fooled[driver, kind])} | {words} |")
    expert = fooled.get(("metadrive-expert", "uniform"))
    if expert is None:
        return
    print("\nof the uniform worlds that fool the expert, and of the others, fool")
    for driver in DRIVERS[1:]:
        other = fooled.get((driver, "uniform"))
        if other is not None:
            n = min(len(expert), len(other))
            where, other = expert[:n], other[:n]
            print(f"| {driver} | {share(other[where])} | {share(other[~where])} |")
    opened = application("metadrive-expert")
    mu = worlds("uniform", opened)[: len(expert)]
    print("\nhow often the expert fails in the lowest and highest third of each range")
    for k, name in enumerate(opened.parameters.names):
        low, high = expert[mu[:, k] < -1 / 3], expert[mu[:, k] > 1 / 3]
        print(f"| {name} | {share(low)} | {share(high)} |")


def _file(out: Path, driver: str, kind: str) -> Path:
    return out / f"{driver.replace(' ', '-').lower()}-{kind}.jsonl"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["rates", "tables"])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--most", type=int, default=max(WORLDS.values()), help="worlds of a kind")
    parser.add_argument("--drivers", nargs="+", choices=DRIVERS, default=DRIVERS)
    parser.add_argument("--kinds", nargs="+", choices=list(WORLDS), default=list(WORLDS))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.what == "tables":
        tables(given.out)
        return
    for driver in given.drivers:
        for kind in given.kinds:
            drive(driver, kind, _file(given.out, driver, kind), given.most)


if __name__ == "__main__":
    main()
