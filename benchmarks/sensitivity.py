"""Which parameters matter: Sobol indices of Q over uniform mu, averaged over tracks.

    python benchmarks/sensitivity.py --rows 256 --seed 0
    python benchmarks/sensitivity.py --tracks SADA-Driving-Navigation-v0 --rows 1024 --seed 0

Row j of every matrix of the design has the same evaluation seed, so that a random world does not
pass for an effect of mu; one more, planted dimension that no world reads must come out as
exactly zero.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.stats import qmc, sobol_indices

from sada_gym.application import Application
from sada_gym.registration import make_application, tracks

DETECTION = [track for track in tracks() if track.startswith("SADA-Detection")]


def indices(application: Application, rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """First-order and total indices of all parameters and the planted one, (d + 1,) each."""
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
    found = sobol_indices(func=values, n=rows)
    return np.ravel(found.first_order), np.ravel(found.total_order)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tracks", nargs="*", default=DETECTION)
    parser.add_argument("--agent", help="by default each track's own")
    parser.add_argument("--rows", type=int, default=256, help="a power of two")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    keywords = {} if arguments.agent is None else {"agent": arguments.agent}
    totals, firsts = [], []
    for track in arguments.tracks:
        application = make_application(track, **keywords)
        first, total = indices(application, arguments.rows, arguments.seed)
        firsts.append(first)
        totals.append(total)
        print(f"{track:30s} first {np.round(first, 3)} total {np.round(total, 3)}", flush=True)
    names = (*application.parameters.names, "planted, read by nothing")
    print("\n| parameter | first order | total | least total of a track | greatest |")
    print("| --- | --- | --- | --- | --- |")
    for i, name in enumerate(names):
        column = np.array(totals)[:, i]
        print(
            f"| {name} | {np.mean(firsts, axis=0)[i]:.3f} | {column.mean():.3f} "
            f"| {column.min():.3f} | {column.max():.3f} |"
        )


if __name__ == "__main__":
    main()
