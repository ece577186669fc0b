"""Which of detection's eight parameters matters: total Sobol indices, averaged over the classes.

    python benchmarks/detection_sensitivity.py --agent photographer --rows 256 --seed 0

Row j of every matrix of the design has the same evaluation seed, so that the random shape and
place do not pass for an effect of mu; a ninth, planted dimension that no world reads must come out
as exactly zero.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.stats import qmc, sobol_indices

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.shapes.catalogue import CLASSES


def total_indices(
    application: DetectionApplication, rows: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """First-order and total indices of the eight parameters and the planted one, (9,) each."""
    dimension = len(application.parameters)
    design = 2 * qmc.Sobol(2 * (dimension + 1), rng=seed).random(rows) - 1
    a, b = design[:, : dimension + 1], design[:, dimension + 1 :]
    seeds = np.random.default_rng(seed).integers(2**31, size=rows).tolist()

    def score(matrix: np.ndarray) -> np.ndarray:
        return application.evaluate(matrix[:, :dimension], seeds).score

    mixed = []
    for i in range(dimension + 1):
        swapped = a.copy()
        swapped[:, i] = b[:, i]
        mixed.append(score(swapped)[None])
    values = {"f_A": score(a)[None], "f_B": score(b)[None], "f_AB": np.array(mixed)}
    found = sobol_indices(func=values, n=rows)
    return np.ravel(found.first_order), np.ravel(found.total_order)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent", default="photographer")
    parser.add_argument("--rows", type=int, default=256, help="a power of two")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--classes", nargs="*", default=list(CLASSES))
    arguments = parser.parse_args()
    totals, firsts = [], []
    for name in arguments.classes:
        application = DetectionApplication(name, agent=arguments.agent)
        first, total = total_indices(application, arguments.rows, arguments.seed)
        firsts.append(first)
        totals.append(total)
        print(f"{name:12s}", np.round(total, 3), flush=True)
    names = (*DetectionApplication.parameters.names, "planted, read by nothing")
    print("\n| parameter | first order | total | least of a class | greatest |")
    print("| --- | --- | --- | --- | --- |")
    for i, name in enumerate(names):
        column = np.array(totals)[:, i]
        print(
            f"| {name} | {np.mean(firsts, axis=0)[i]:.3f} | {column.mean():.3f} "
            f"| {column.min():.3f} | {column.max():.3f} |"
        )


if __name__ == "__main__":
    main()
