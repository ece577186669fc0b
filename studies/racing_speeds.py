"""How fast the guidance of UAV racing flies: the table by which its one speed was chosen.

`python studies/racing_speeds.py` prints it. The rule: the highest speed, in steps of 0.5 m/s
from 8 m/s up, at which the guidance told the truth passes at least 98 % of the gates of every
template and 95 % of those of mild tracks, and scores above 0.7 on at least 99 % of uniform mu; all
lower speeds must do so, too. No pilot that sees is asked. In brackets: at how many gates the next
one was in the camera's view when the flight there began.
"""

import argparse

import numpy as np

from sada_gym.envs.uav.agent.privileged import PrivilegedPilot
from sada_gym.envs.uav.application import LOCKSTEP
from sada_gym.envs.uav.camera.pinhole import COLUMNS, ROWS, camera
from sada_gym.envs.uav.course import benchmark_starts
from sada_gym.envs.uav.episodes import Ending, Races
from sada_gym.envs.uav.world.templates import TEMPLATES

MILD = 0.25
TEMPLATE_SHARE, MILD_SHARE, FEASIBLE_SHARE, THRESHOLD = 0.98, 0.95, 0.99, 0.7


def fly(anchors, mu, seeds, speed_m_s):
    """Fly the tracks of mu; give passed and seen (n, g) and the times (n,)."""
    pilot, parts = PrivilegedPilot(speed_m_s), []
    tracks = TEMPLATES[anchors].tracks(mu)
    starts = benchmark_starts(tracks, seeds)
    for first in range(0, len(starts), LOCKSTEP):
        races = Races(starts[first : first + LOCKSTEP])
        seen, last = np.zeros(races.endings.shape, bool), np.full(len(races), -1)
        while len(which := races.under_way()):
            for i in which[races.next_gate[which] != last[which]].tolist():
                last[i] = gate = races.next_gate[i]
                seen[i, gate] = in_view(races.states[i], races.gates[i, gate])
            races.step(which, pilot.act(races, which))
        parts.append((races.endings == Ending.PASSED, seen, races.time_s))
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


def in_view(state, gate):
    """Whether a drone's camera sees the middle of a gate."""
    (column, row), *_ = camera().project(state[:7], gate[None, :3])
    return 0 <= column < COLUMNS and 0 <= row < ROWS


def figures(anchors, speed_m_s, *, templates, mild, uniform):
    """Measure one speed on the tracks of one number of anchor points."""
    rng = np.random.default_rng(0)
    dimension = 2 * anchors

    def flown(width, count):
        mu = rng.uniform(-width, width, (count, dimension))
        return fly(anchors, mu, rng.integers(2**31, size=count).tolist(), speed_m_s)

    row = {}
    for name, width, count in (("template", 0.0, templates), ("mild", MILD, mild)):
        passed, seen, _ = flown(width, count)
        row[name], row[f"{name}, seen"] = passed.mean(), seen.mean()
    passed, seen, time_s = flown(1.0, uniform)
    score = passed.mean(axis=1)
    row["uniform"], row["uniform, seen"] = score.mean(), seen.mean()
    row["feasible"] = (score > THRESHOLD).mean()
    row["time"] = time_s.mean()
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--low", type=float, default=8.0)
    parser.add_argument("--high", type=float, default=12.5)
    parser.add_argument("--templates", type=int, default=32)
    parser.add_argument("--mild", type=int, default=100)
    parser.add_argument("--uniform", type=int, default=1000)
    arguments = parser.parse_args()
    print(
        "| m/s | anchors | template, passed (seen) | mild, passed (seen) "
        "| uniform, passed (seen) | uniform with Q > 0.7 | mean time | holds |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    best, unbroken = None, True
    for speed in np.arange(arguments.low, arguments.high + 0.25, 0.5).tolist():
        for anchors in TEMPLATES:
            row = figures(
                anchors,
                speed,
                templates=arguments.templates,
                mild=arguments.mild,
                uniform=arguments.uniform,
            )
            holds = (
                row["template"] >= TEMPLATE_SHARE
                and row["mild"] >= MILD_SHARE
                and row["feasible"] >= FEASIBLE_SHARE
            )
            unbroken = unbroken and holds
            cells = [
                f"{100 * row[name]:.1f} % ({100 * row[f'{name}, seen']:.1f})"
                for name in ("template", "mild", "uniform")
            ]
            print(
                f"| {speed:g} | {anchors} | {' | '.join(cells)} | {100 * row['feasible']:.1f} % "
                f"| {row['time']:.1f} s | {'yes' if holds else 'no'} |",
                flush=True,
            )
        best = speed if unbroken else best
    print(f"\nThe rule chooses {best:g} m/s." if best else "\nNo speed holds.")


if __name__ == "__main__":
    main()
