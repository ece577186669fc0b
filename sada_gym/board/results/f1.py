"""F1: how often samples fool and how much they cover, in the one figure that orders a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.board.results.figures import Draws, Figure, figure
from sada_gym.experiment.measure import Measures

RESAMPLES = 10_000

Values = npt.NDArray[np.float64]


def f1(afr: npt.ArrayLike, relative_coverage: npt.ArrayLike, ideal_afr: float = 1.0) -> Values:
    """Join the AFR and the relative coverage of samples by their harmonic mean.

    AFR over that of ideal samples, at most 1, stands in for precision, and relative coverage for
    recall; precision and recall of distributions are joined so (Sajjadi et al. 2018,
    Kynkäänniemi et al. 2019). An adversary that is bad at either has a low F1.

    Args:
        afr: Attack fooling rates, of any shape.
        relative_coverage: Coverages over that of ideal samples, of the same shape.
        ideal_afr: The AFR of ideal samples on the track.

    Returns:
        F1 of the same shape; 0 where both are 0.
    """
    precision = np.minimum(np.asarray(afr, np.float64) / ideal_afr, 1.0)
    recall = np.asarray(relative_coverage, np.float64)
    total = precision + recall
    joined = 2 * precision * recall / np.where(total > 0, total, 1.0)
    return np.asarray(joined, np.float64)


def f1_figure(
    runs: Mapping[str, Sequence[Measures]],
    samples: Mapping[str, int],
    ideal_afr: Mapping[str, float],
) -> Figure | None:
    """Average F1 over seeds, then over tracks, with a 95 % interval.

    The interval is the bootstrap over seeds. Where a track has one seed, or seeds that differ no
    more than test samples alone would make them, the test samples are drawn anew instead: AFR from
    its Jeffreys posterior, and coverage from that of a share of as many points as samples fooled.

    Args:
        runs: The measures of each track's runs; all with relative coverage.
        samples: M of each track.
        ideal_afr: The AFR of ideal samples by track; 1 where it is not known.
    """
    values, draws = [], []
    rng = np.random.default_rng(0)
    for track, seeds in runs.items():
        ideal = ideal_afr.get(track) or 1.0
        values.append([_f1_of(measures, ideal) for measures in seeds])
        draws.append(_redrawn(seeds, samples[track], ideal, rng))
    return figure(values, draws=np.array(draws)) if values else None


def _f1_of(measures: Measures, ideal: float) -> float:
    assert measures.relative_coverage is not None
    return float(f1(measures.afr, measures.relative_coverage, ideal))


def _redrawn(
    seeds: Sequence[Measures], samples: int, ideal: float, rng: np.random.Generator
) -> Draws:
    """Draw what the mean F1 of a track could have been with other test samples, (resamples,)."""
    total = np.zeros(RESAMPLES)
    for measures in seeds:
        fooled, coverage = measures.fooled, measures.coverage or 0.0
        of_ideal = coverage / measures.relative_coverage if measures.relative_coverage else 1.0
        rates = rng.beta(fooled + 0.5, samples - fooled + 0.5, RESAMPLES)
        covered = rng.beta(coverage * fooled + 0.5, (1.0 - coverage) * fooled + 0.5, RESAMPLES)
        total += f1(rates, covered / of_ideal, ideal)
    return total / len(seeds)
