"""What fails a driver: its fooling rate by how the camera is mounted, and by the weather.

    python benchmarks/driving_diagnosis.py

Over the uniform mu of the shipped reference sets: fifths of the pitch for the low and the high half
of the heights, then each weather.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

from sada_gym.reference import load_reference
from sada_gym.registration import make_application, tracks

DRIVING = [track for track in tracks() if track.startswith("SADA-Driving")]
FIFTHS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agent", default="cil")
    agent = parser.parse_args().agent
    mounts, weathers = [], []
    for track in DRIVING:
        application = make_application(track, agent=agent)
        reference = load_reference(track, application)
        if reference is None:
            raise SystemExit(f"There is no reference set of {agent}, {track}.")
        rate = reference.fooled / reference.entry.seeds
        height, pitch, weather = application.parameters.parameters
        parts = ((reference.mu + 1) / 2).T
        high = parts[0] >= 0.5
        fifth = np.minimum((parts[1] * FIFTHS).astype(int), FIFTHS - 1)
        for half, name in ((~high, "low"), (high, "high")):
            rates = [rate[half & (fifth == i)].mean() for i in range(FIFTHS)]
            mounts.append([track, name, *(f"{100 * value:.1f} %" for value in rates)])
        assert weather.choices is not None
        count = len(weather.choices)
        which = np.minimum((parts[2] * count).astype(int), count - 1)
        rates = [rate[which == i].mean() for i in range(count)]
        weathers.append([track, *(f"{100 * value:.1f} %" for value in rates)])
    ends = np.linspace(pitch.low, pitch.high, FIFTHS + 1)
    pitches = [f"{a:g} to {b:g}°" for a, b in itertools.pairwise(ends)]
    middle = (height.low + height.high) / 2
    print(f"Low: below {middle:g} m. Steep on the left, shallow on the right.\n")
    for head, rows in (
        (("track", "camera", *pitches), mounts),
        (("track", *weather.choices), weathers),
    ):
        print(f"| {' | '.join(head)} |\n|{' --- |' * len(head)}")
        print("\n".join(f"| {' | '.join(row)} |" for row in rows), end="\n\n")


if __name__ == "__main__":
    main()
