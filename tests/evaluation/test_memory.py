"""Evaluations leave nothing behind: the memory of a process does not grow with their number."""

import subprocess
import sys

import pytest

MEASURE = """
import sys, tempfile, numpy, psutil
from sada_gym.oracle import Oracle
track, first, more = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])

def evaluate(count):
    mu = numpy.random.default_rng(count).uniform(-1, 1, (count, oracle.dimension))
    for start in range(0, count, 50):
        oracle(mu[start : start + 50])
    return psutil.Process().memory_info().rss / 2**20

with tempfile.TemporaryDirectory() as folder:
    with Oracle(track, budget=first + more, store=folder + "/run.sqlite") as oracle:
        before = evaluate(first)
        print(evaluate(more) - before)
"""


@pytest.mark.parametrize(
    ("track", "first", "more"),
    [
        ("SADA-Analytic-v0", 1_000, 10_000),
        pytest.param("SADA-Detection-Car-v0", 1_000, 10_000, marks=pytest.mark.slow),
        pytest.param("SADA-Driving-Straight-v0", 200, 600, marks=pytest.mark.slow),
        pytest.param("SADA-UAV-5Anchors-v0", 200, 800, marks=pytest.mark.slow),
    ],
)
def test_memory_does_not_grow_with_evaluations(track, first, more):
    """16 MiB over the evaluations: a picture kept of each would be hundreds."""
    command = [sys.executable, "-c", MEASURE, track, str(first), str(more)]
    grown = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert grown < 16, f"{track} grew by {grown:.1f} MiB over {more} evaluations"
