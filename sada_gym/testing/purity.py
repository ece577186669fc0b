"""Tests that an application is pure: Q(mu, seed) never depends on the rest of the batch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from sada_gym.application import Application, Outcomes
from sada_gym.foundations.seeds import SEED_BOUND
from sada_gym.parameters import Mu
from sada_gym.testing.processes import in_fresh_process


def draw_worlds(application: Application, n: int, seed: int) -> tuple[Mu, list[int]]:
    """Draw n uniform mu, (n, d) float32, and a seed for each."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1.0, 1.0, size=(n, len(application.parameters))).astype(np.float32)
    return mu, [int(s) for s in rng.integers(SEED_BOUND, size=n)]


def assert_pure(
    application: Application,
    *,
    n: int = 70,
    seed: int = 0,
    sizes: Iterable[int] | None = None,
    alone: int | None = None,
    other_process: bool = True,
) -> None:
    """Check that Q(mu, seed) is the same alone, in any batch, in any order, in another process.

    Args:
        application: The application.
        n: Number of worlds to compare.
        seed: Fixes the worlds.
        sizes: The batch sizes to try, 1 to n by default: about n * n / 2 evaluations.
        alone: How many of the worlds to evaluate alone, all by default.
        other_process: Whether to compare with a fresh process as well; the application must be
            picklable then.

    Raises:
        AssertionError: If an outcome differs, with a message that says which and how.
    """
    mu, seeds = draw_worlds(application, n, seed)
    reference = application.evaluate(mu, seeds)
    rng = np.random.default_rng(seed)
    batches = [
        ("evaluated a second time", list(range(n))),
        *(("evaluated alone", [i]) for i in range(n if alone is None else alone)),
        *(
            (f"in a batch of {size}", [(7 * size + i) % n for i in range(size)])
            for size in (range(1, n + 1) if sizes is None else sizes)
        ),
        ("in another order", rng.permutation(n).tolist()),
        ("beside copies of itself", rng.integers(n, size=n).tolist()),
    ]
    for how, rows in batches:
        outcomes = application.evaluate(mu[rows], [seeds[i] for i in rows])
        compare_outcomes(reference, outcomes, how, rows)
    if other_process:
        assert_same_in_another_process(application, n=n, seed=seed)


def assert_same_in_another_process(application: Application, *, n: int = 70, seed: int = 0) -> None:
    """Check that a pickled copy in a fresh process gives the same outcomes."""
    mu, seeds = draw_worlds(application, n, seed)
    reference = application.evaluate(mu, seeds)
    elsewhere = in_fresh_process(application.evaluate, mu, seeds, home=type(application))
    compare_outcomes(reference, elsewhere, "in another process")


def compare_outcomes(
    reference: Outcomes, outcomes: Outcomes, how: str, rows: Sequence[int] | None = None
) -> None:
    """Check that outcomes equal the reference's at these rows (all by default), infos included."""
    rows = range(len(reference.score)) if rows is None else rows
    for position, row in enumerate(rows):
        before, after = reference.score[row], outcomes.score[position]
        if before != after:
            raise AssertionError(
                f"Expected the same score whatever surrounds an evaluation, got {after!r} for "
                f"world {row} {how}, {before!r} at first (difference {after - before:.2g})."
            )
        first, second = reference.infos[row], outcomes.infos[position]
        if not data_equivalence(first, second, exact=True):
            keys = [
                key
                for key in sorted({*first, *second})
                if not data_equivalence(first.get(key), second.get(key), exact=True)
            ]
            raise AssertionError(
                f"Expected the same info whatever surrounds an evaluation, got other values of "
                f"{keys} for world {row} {how}."
            )
