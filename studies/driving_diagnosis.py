"""What fails a driver: its fooling rate by how the camera is mounted, and by the weather.

    python -m studies.driving_diagnosis

Over the uniform mu of the shipped reference sets: fifths of the pitch for the low and the high half
of the heights, then each weather.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable

import numpy as np
from scipy.stats import binned_statistic, binned_statistic_2d

from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.registration import tracks
from sada_gym.measures.reference import load_reference

HEIGHT, PITCH, WEATHER = DrivingApplication.parameters.parameters
FIFTHS = 5


def row(*cells: str, rates: Iterable[float]) -> str:
    """A line of a table."""
    return f"| {' | '.join([*cells, *(f'{100 * rate:.1f} %' for rate in rates)])} |"


def head(*cells: str) -> str:
    """A table's first two lines."""
    return f"| {' | '.join(cells)} |\n|{' --- |' * len(cells)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agent", default="cil")
    agent = parser.parse_args().agent
    ends = np.linspace(PITCH.low, PITCH.high, FIFTHS + 1)
    mounts = [head("track", "camera", *(f"{a:g} to {b:g}°" for a, b in itertools.pairwise(ends)))]
    weathers = [head("track", *WEATHER.choices)]
    for track in tracks(installed=True):
        if not track.startswith(DrivingApplication.name):
            continue
        application = make_application(track, agent=agent)
        reference = load_reference(track, application)
        if reference is None:
            raise SystemExit(f"There is no reference set of {agent}, {track}.")
        rate = reference.fooling_rate
        height, pitch, weather = application.parameters.physical(reference.mu).T
        ranges = [(HEIGHT.low, HEIGHT.high), (PITCH.low, PITCH.high)]
        mounted = binned_statistic_2d(height, pitch, rate, bins=(2, FIFTHS), range=ranges).statistic
        mounts += [
            row(track, name, rates=of_half)
            for name, of_half in zip(("low", "high"), mounted, strict=True)
        ]
        parts = len(WEATHER.choices)
        span = (WEATHER.low, WEATHER.high)
        rates = binned_statistic(weather, rate, bins=parts, range=span).statistic
        weathers.append(row(track, rates=rates))
    middle = (HEIGHT.low + HEIGHT.high) / 2
    print(f"Low: below {middle:g} m. Steep on the left, shallow on the right.\n")
    print(*mounts, "", *weathers, sep="\n")


if __name__ == "__main__":
    main()
