"""The test samples of results: their file, and their digest."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.foundations.files import read_array_groups, shown

Samples = Mapping[int, Evaluations]
"""The test samples of each seed, by ascending seed."""

_KINDS = {"seeds": ("i8", 1), "mu": ("f4", 2), "score": ("f8", 1)}


def samples_bytes(results: Mapping[str, Samples]) -> bytes:
    """Pack the samples of results as NPZ.

    A result at PLACE has PLACE.seeds (k,) int64, PLACE.mu (k * M, d) float32 and PLACE.score
    (k * M,) float64: its seeds, and the M samples of each. The evaluation seeds follow from the
    seeds; samples of others are a UserError. A result without samples has no arrays.
    """
    arrays: dict[str, Any] = {}
    for place, samples in results.items():
        ordered = [samples[seed] for seed in sorted(samples)]
        for seed, rows in samples.items():
            if not np.array_equal(rows.seed, _evaluation_seeds(seed, len(rows))):
                raise UserError(
                    f"Expected the evaluation seeds of the test stream of seed {seed} of {place}, "
                    "got others. Evaluate the samples by sada-gym submit --samples."
                )
        if ordered:
            arrays[f"{place}.seeds"] = np.array(sorted(samples), np.int64)
            arrays[f"{place}.mu"] = np.concatenate([rows.mu for rows in ordered])
            arrays[f"{place}.score"] = np.concatenate([rows.score for rows in ordered])
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def samples_sha256(samples: Samples) -> str:
    """Return the SHA-256 of samples: the mu, scores and evaluation seeds of each seed."""
    digest = hashlib.sha256()
    for seed in sorted(samples):
        rows = samples[seed]
        digest.update(f"{seed}:{len(rows)}:{rows.mu.shape[1]};".encode())
        for array, dtype in ((rows.mu, "<f4"), (rows.score, "<f8"), (rows.seed, "<i8")):
            digest.update(np.ascontiguousarray(array, dtype).tobytes())
    return digest.hexdigest()


def read_samples(path: Path) -> dict[str, dict[int, Evaluations]]:
    """Read samples by `TRACK.AGENT.RULE` and seed; raises a FileError if the file is damaged."""
    return {
        place: _unpack(path, shown(place), **arrays)
        for place, arrays in read_array_groups(path, _KINDS).items()
    }


def check_ascending(path: Path, what: str, values: Sequence[Any]) -> None:
    """Raise a FileError if values of a file do not ascend, each once."""
    if list(values) != sorted(set(values)):
        raise FileError(
            f"Expected ascending {what} in {path}, each once, got {shown(str(values))}. Restore "
            "the file, or make it again."
        )


def _unpack(
    path: Path, place: str, seeds: npt.NDArray[Any], mu: npt.NDArray[Any], score: npt.NDArray[Any]
) -> dict[int, Evaluations]:
    ascending = seeds.tolist()
    count, rest = divmod(len(mu), max(1, len(seeds)))
    if rest or not count or not ascending or len(score) != len(mu):
        raise FileError(
            f"Expected as many samples of each seed of {place} in {path}, each with a score, got "
            f"{len(seeds)} seeds, {len(mu)} mu and {len(score)} scores. Restore the file, or make "
            "it again."
        )
    check_ascending(path, f"seeds of {place}", ascending)
    if ascending[0] < 0:
        raise FileError(f"Expected seeds of {place} in {path} from 0 up, got {ascending[0]}.")
    parts = zip(ascending, np.split(mu, len(seeds)), np.split(score, len(seeds)), strict=True)
    return {seed: Evaluations(m, q, _evaluation_seeds(seed, count)) for seed, m, q in parts}


@lru_cache(maxsize=256)
def _evaluation_seeds(seed: int, count: int) -> npt.NDArray[np.int64]:
    """Return the evaluation seeds of a seed's samples; the array is shared and read-only."""
    seeds = np.array(evaluation_seeds(seed, "test", 0, count), np.int64)
    seeds.flags.writeable = False
    return seeds
