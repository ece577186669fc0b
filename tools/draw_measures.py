"""Draw docs/images/measures.png: what AFR, coverage and novelty say of six sets of samples.

    python -m tools.draw_measures
    python -m tools.draw_measures --table  # coverage in more dimensions; draws nothing

The four boxes of `SADA-Analytic-v0` are the fooling set. Every set has M = 250 samples, and every
search has 1,000 uniform queries.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from sada_gym.analyses.plots.style import FOOLED, new_figure, png
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from sada_gym.measures.coverage import fooling_coverage, relative_coverage
from sada_gym.measures.novelty import novelty

OUT = Path(__file__).parents[1] / "docs" / "images" / "measures.png"
SAMPLES, QUERIES, REFERENCE, SEED, DRAWS = 250, 1_000, 2_000, 0, 10
BOX = "#fbe3d6"
Points = npt.NDArray[np.float32]


def some(points: Points, rng: np.random.Generator) -> Points:
    """Choose M points, each at most once where there are enough."""
    return rng.choice(points, SAMPLES, replace=len(points) < SAMPLES)


def make_samples(
    boxes: AnalyticApplication, drawn: Points, queries: Points, rng: np.random.Generator
) -> dict[str, Points]:
    """Return the sets of samples, each (M, 2), by what they are called.

    Args:
        boxes: The application.
        drawn: Points of the fooling set.
        queries: The training queries.
        rng: The source of randomness.
    """
    region = boxes.fooling_region(drawn)
    stored = queries[boxes.fooling_region(queries) >= 0]
    blurred = drawn + rng.normal(0, 0.1, drawn.shape)
    return {
        "One world, repeated": near(drawn[0], rng),
        "One of four regions": some(drawn[region == 0], rng),
        "Stored queries": some(stored, rng),
        "Uniform in the box": uniform(SAMPLES, 2, rng),
        "All four, but imprecise": some(np.clip(blurred, -1, 1).astype(np.float32), rng),
        "Ideal": some(drawn, rng),
    }


def near(point: Points, rng: np.random.Generator) -> Points:
    """Repeat a point, shaken a little: (M, d)."""
    return (point + rng.normal(0, 0.003, (SAMPLES, len(point)))).astype(np.float32)


def uniform(count: int, dimension: int, rng: np.random.Generator) -> Points:
    """Draw points of the whole space, (count, d)."""
    return rng.uniform(-1, 1, (count, dimension)).astype(np.float32)


def coverage_of(boxes: AnalyticApplication, mu: Points, known: Points, ideal: Points) -> float:
    """Measure relative coverage."""
    own, best = (
        fooling_coverage(one, boxes.fooling_region(one) >= 0, known).coverage for one in (mu, ideal)
    )
    return relative_coverage(own, best)


def draw(axes: Axes, boxes: AnalyticApplication, mu: Points, queries: Points) -> None:
    """Draw the boxes, the queries as grey points, and samples: full where they fool."""
    for centre in boxes.centres:
        corner, (width, height) = centre - boxes.half_sides, 2 * boxes.half_sides
        axes.add_patch(Rectangle(corner, width, height, facecolor=BOX, edgecolor=FOOLED, zorder=0))
    fooled = boxes.fooling_region(mu) >= 0
    axes.scatter(*queries.T, s=1.5, color="#c9d1d9", linewidths=0)
    axes.scatter(*mu[~fooled].T, s=7, facecolor="none", edgecolor=MUTED, linewidths=0.6)
    axes.scatter(*mu[fooled].T, s=7, color=FOOLED, linewidths=0)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), xticks=(), yticks=(), aspect="equal")
    for spine in axes.spines.values():
        spine.set_color("#c9d1d9")


@own_style()
def draw_all(out: Path) -> None:
    """Draw and measure the six sets."""
    rng = np.random.default_rng(SEED)
    boxes = AnalyticApplication()
    truth = boxes.sample_fooling_set(2 * REFERENCE, rng)
    known, drawn = truth[:REFERENCE], truth[REFERENCE:]
    queries = uniform(QUERIES, 2, rng)
    sets = make_samples(boxes, drawn, queries, rng)
    usual = novelty(sets["Ideal"], queries).median
    figure = new_figure(7.5, 6.3)
    for axes, (name, mu) in zip(figure.subplots(2, 3).ravel(), sets.items(), strict=True):
        draw(axes, boxes, mu, queries)
        rate = (boxes.fooling_region(mu) >= 0).mean()
        coverage = coverage_of(boxes, mu, known, sets["Ideal"])
        new = novelty(mu, queries).median / usual
        said = f"AFR {100 * rate:.0f} %, coverage {100 * coverage:.0f} %\nnovelty {new:.1f}"
        axes.set_title(name, fontsize=11, color=INK, fontweight="bold")
        axes.set_xlabel(said, fontsize=11, color=INK)
        print(f"{name}: {said}".replace("\n", ", "))
    out.write_bytes(png(figure))


def print_table() -> None:
    """Print relative coverage in 2 to 32 dimensions, the mean of some draws."""
    kinds = ("one point", "one region", "two regions", "uniform in the box")
    print("d", *kinds, sep=" | ")
    for dimension in (2, 5, 8, 16, 32):
        boxes = AnalyticApplication(dimension=dimension)
        rows = []
        for seed in range(DRAWS):
            rng = np.random.default_rng(seed)
            truth = boxes.sample_fooling_set(8 * REFERENCE, rng)
            known, drawn = truth[:REFERENCE], truth[REFERENCE:]
            region = boxes.fooling_region(drawn)
            sets = (
                near(drawn[0], rng),
                some(drawn[region == 0], rng),
                some(drawn[region < 2], rng),
                uniform(SAMPLES, dimension, rng),
            )
            ideal = some(drawn, rng)
            rows.append([coverage_of(boxes, mu, known, ideal) for mu in sets])
        print(dimension, *(f"{mean:.2f}" for mean in np.mean(rows, axis=0)), sep=" | ")


def main() -> None:
    """Draw the picture, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    if arguments.table:
        print_table()
    else:
        draw_all(arguments.out)


if __name__ == "__main__":
    main()
