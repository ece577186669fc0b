"""Which parameters matter: Sobol indices of Q over uniform mu, by track and averaged over tracks.

    python -m studies.sensitivity --rows 256 --seed 0
    python -m studies.sensitivity --tracks SADA-Driving-Navigation-v0 --rows 1024 --seed 0

In brackets: 95 % intervals from resampled rows.

Row j of every matrix of the design has the same evaluation seed, so that a random world does not
pass for an effect of mu; one more, planted dimension that no world reads must come out as
exactly zero.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from scipy.stats import qmc, sobol_indices

from sada_gym.application import Application
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.registration import tracks

DETECTION = [track for track in tracks() if track.startswith("SADA-Detection-")]


def indices(application: Application, rows: int, seed: int) -> np.ndarray:
    """First-order and total indices of all parameters and the planted one: (2, 3, d + 1).

    The middle axis is value, low and high end of the 95 % interval.
    """
    dimension = len(application.parameters)
    design = 2 * qmc.Sobol(2 * (dimension + 1), rng=seed).random(rows) - 1
    a, b = design[:, : dimension + 1], design[:, dimension + 1 :]
    seeds = np.random.default_rng(seed).integers(2**31, size=rows).tolist()

    def score(matrix: np.ndarray) -> np.ndarray:
        parts = [
            application.evaluate(matrix[i : i + 64, :dimension], seeds[i : i + 64]).score
            for i in range(0, rows, 64)
        ]
        return np.concatenate(parts)

    mixed = []
    for i in range(dimension + 1):
        swapped = a.copy()
        swapped[:, i] = b[:, i]
        mixed.append(score(swapped)[None])
    values = {"f_A": score(a)[None], "f_B": score(b)[None], "f_AB": np.array(mixed)}
    sobol = sobol_indices(func=values, n=rows)
    with warnings.catch_warnings():
        # The planted one's index is zero in every resample, so that it has no interval.
        warnings.filterwarnings("ignore", message="The BCa confidence interval cannot be")
        warnings.filterwarnings("ignore", category=RuntimeWarning)
        spread = sobol.bootstrap()
    pairs = (sobol.first_order, spread.first_order), (sobol.total_order, spread.total_order)
    return np.array(
        [
            [
                np.ravel(value),
                np.ravel(ends.confidence_interval.low),
                np.ravel(ends.confidence_interval.high),
            ]
            for value, ends in pairs
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tracks", nargs="+", default=DETECTION)
    parser.add_argument("--agent", help="by default each track's own")
    parser.add_argument("--rows", type=int, default=256, help="a power of two")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    keywords = {} if arguments.agent is None else {"agent": arguments.agent}
    results = []
    for track in arguments.tracks:
        application = make_application(track, **keywords)
        results.append(indices(application, arguments.rows, arguments.seed))
        names = (*application.parameters.names, "planted, read by nothing")
        print(f"\n| {track} | first order | total |\n| --- | --- | --- |")
        for i, name in enumerate(names):
            cells = [
                f"{value:.3f}" + ("" if np.isnan(low) else f" ({low:.3f} to {high:.3f})")
                for value, low, high in results[-1][..., i]
            ]
            print(f"| {name} | {cells[0]} | {cells[1]} |", flush=True)
    mean = np.mean(results, axis=0)
    totals = np.array(results)[:, 1, 0]
    print(
        "\n| parameter, mean of tracks | first order | total | least total of a track | greatest |"
    )
    print("| --- | --- | --- | --- | --- |")
    for i, name in enumerate(names):
        print(
            f"| {name} | {mean[0, 0, i]:.3f} | {mean[1, 0, i]:.3f} "
            f"| {totals[:, i].min():.3f} | {totals[:, i].max():.3f} |"
        )


if __name__ == "__main__":
    main()
