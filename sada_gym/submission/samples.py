"""The test samples of a result: their file, and their digest."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sada_gym.errors import FileError
from sada_gym.evaluations import Evaluations
from sada_gym.files import read_arrays

Samples = Mapping[int, Evaluations]
"""The test samples of each seed, by ascending seed."""

_KINDS = {"run": ("i8", 1), "mu": ("f4", 2), "score": ("f8", 1), "seed": ("i8", 1)}


def samples_bytes(samples: Samples, dimension: int) -> bytes:
    """Pack samples as NPZ: run (n,) int64, the seed of each row's run, then mu, score, seed.

    Args:
        samples: The samples of each seed.
        dimension: The number of semantic parameters; mu has that many columns even without rows.
    """
    ordered = [samples[seed] for seed in sorted(samples)]
    runs = [np.full(len(samples[seed]), seed, np.int64) for seed in sorted(samples)]
    buffer = io.BytesIO()
    np.savez(
        buffer,
        run=np.concatenate([np.zeros(0, np.int64), *runs]),
        mu=np.concatenate([np.zeros((0, dimension), np.float32), *(one.mu for one in ordered)]),
        score=np.concatenate([np.zeros(0), *(one.score for one in ordered)]),
        seed=np.concatenate([np.zeros(0, np.int64), *(one.seed for one in ordered)]),
    )
    return buffer.getvalue()


def samples_sha256(samples: Samples) -> str:
    """Give the SHA-256 of samples: of each seed, its mu, scores and evaluation seeds."""
    digest = hashlib.sha256()
    for seed in sorted(samples):
        one = samples[seed]
        digest.update(f"{seed}:{len(one)}:{one.mu.shape[1]};".encode())
        for array, dtype in ((one.mu, "<f4"), (one.score, "<f8"), (one.seed, "<i8")):
            digest.update(np.ascontiguousarray(array, dtype).tobytes())
    return digest.hexdigest()


def read_samples(path: Path) -> dict[int, Evaluations]:
    """Read the samples of a result.

    Raises:
        FileError: If the file cannot be read or does not hold such samples.
    """
    arrays = read_arrays(path, _KINDS)
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise FileError(
            f"Expected as many rows of mu as scores and seeds in {path}, got {counts}. "
            "Restore the file, or make it anew."
        )
    found = {}
    for seed in np.unique(arrays["run"]).tolist():
        rows = arrays["run"] == seed
        found[seed] = Evaluations(*(arrays[name][rows] for name in ("mu", "score", "seed")))
    return found
