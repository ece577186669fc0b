"""Reference sets: dense samples of the box that show where a track's agent is fooled."""

from __future__ import annotations

import functools
import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import evaluation_seeds, fools
from sada_gym.foundations.arithmetic import arithmetic, could_be_canonical
from sada_gym.foundations.arrays import Bools, Floats, Floats32
from sada_gym.foundations.files import (
    MAX_ARRAYS_BYTES,
    Strict,
    file_errors,
    read_file,
    read_model,
    write_file,
    write_model,
)
from sada_gym.parameters import Mu

FOLDER = Path(__file__).with_name("references")
INDEX = "index.json"

_STREAM_SEED = _SPLIT_SEED = 0


class ReferenceEntry(Strict):
    """A row of the index of reference sets: what one of them was made of.

    The version is the environment's, the fingerprint the application's: the agent's SHA-256.
    `seeds` is the number of evaluations of each point; `sobol_seed` makes the points, see
    `reference_mu`. The SHA-256 are those of the points' float32 bytes, and of the file.
    """

    track: str
    agent: str
    version: int
    fingerprint: str
    points: int
    seeds: int
    sobol_seed: int
    mu_sha256: str
    sha256: str

    @property
    def file(self) -> str:
        """Return the file's name."""
        return f"{self.track}.{self.agent}.npz"


class ReferenceIndex(Strict):
    """All reference sets that are shipped."""

    references: tuple[ReferenceEntry, ...]


@dataclass(frozen=True, eq=False)
class Reference:
    """A dense sample of the box: scrambled Sobol points, each evaluated on `entry.seeds` seeds.

    `fooled`, (n,), says on how many seeds a point fooled, `mean_score`, (n,), what its mean Q is.
    """

    entry: ReferenceEntry
    mu: Mu
    fooled: npt.NDArray[np.uint8]
    mean_score: Floats32

    @property
    def fooling_rate(self) -> Floats:
        """Return the share of its seeds on which each point fooled, (n,)."""
        return self.fooled / self.entry.seeds

    @property
    def fooling(self) -> Bools:
        """Say which points belong to the fooling set {mu: P(Q <= epsilon) >= 0.5}, (n,)."""
        return 2 * self.fooled.astype(np.int64) >= self.entry.seeds

    @property
    def fooling_set(self) -> Mu:
        """Return the points of the fooling set, (m, d)."""
        return self.mu[self.fooling]

    @property
    def uniform_rate(self) -> float:
        """Return the share of all evaluations that fooled: the AFR of uniform samples."""
        return float(self.fooled.sum(dtype=int) / (self.entry.points * self.entry.seeds))

    def split(self) -> tuple[Mu, Mu]:
        """Split the fooling set at random, always alike: points to measure on, points to draw.

        Ideal samples that were among the points to be covered would cover all of them.
        """
        inside = self.fooling_set
        order = np.random.default_rng(_SPLIT_SEED).permutation(len(inside))
        return inside[order[::2]], inside[order[1::2]]


@functools.lru_cache(maxsize=8)
def reference_mu(dimension: int, points: int, sobol_seed: int) -> Mu:
    """Make a reference set's points: the first of a scrambled Sobol sequence, (points, d) float32.

    The array is shared and read-only.
    """
    from scipy.stats.qmc import Sobol

    exponent = (points - 1).bit_length()
    unit = Sobol(dimension, scramble=True, rng=sobol_seed).random_base2(exponent)[:points]
    mu: Mu = (2.0 * unit - 1.0).astype(np.float32)
    mu.flags.writeable = False
    return mu


def reference_seeds(point: int, seeds: int) -> list[int]:
    """Return the evaluation seeds of a point, from a stream that no attack draws from."""
    return evaluation_seeds(_STREAM_SEED, "validation", point * seeds, seeds)


def write_reference(
    folder: str | Path,
    track: str,
    application: Application,
    scores: Floats,
    *,
    sobol_seed: int,
) -> ReferenceEntry:
    """Write the reference set of a track's application and enter it into the folder's index.

    The scores, (n, k), are Q of each point on each of its k seeds.

    Raises:
        ValueError: If the application has no fingerprint, or a score is no number.
    """
    fingerprint = application.fingerprint
    if fingerprint is None or not np.isfinite(scores).all():
        raise UserError(
            "Expected finite scores of an application with a fingerprint, got "
            f"{np.isfinite(scores).sum()} finite scores of {scores.size} and the fingerprint "
            f"{fingerprint}. Fix the scoring, or give the application a fingerprint."
        )
    points, seeds = scores.shape
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        fooled=fools(scores, application.fooling_threshold).sum(axis=1).astype(np.uint8),
        mean_score=scores.mean(axis=1).astype(np.float32),
    )
    entry = ReferenceEntry(
        track=track,
        agent=application.agent_name,
        version=application.version,
        fingerprint=fingerprint,
        points=points,
        seeds=seeds,
        sobol_seed=sobol_seed,
        mu_sha256=_mu_sha256(reference_mu(len(application.parameters), points, sobol_seed)),
        sha256=hashlib.sha256(buffer.getvalue()).hexdigest(),
    )
    folder = Path(folder)
    with file_errors("make the folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / entry.file, buffer.getvalue())
    others = [e for e in read_index(folder).references if e.file != entry.file]
    ordered = sorted([*others, entry], key=lambda e: e.file)
    write_model(folder / INDEX, ReferenceIndex(references=tuple(ordered)))
    return entry


def read_index(folder: str | Path = FOLDER) -> ReferenceIndex:
    """List the reference sets that a folder holds; raise `FileError` if it cannot be read."""
    folder = Path(folder)
    path = folder / INDEX
    with file_errors("read", folder):
        if folder.is_file():
            raise FileError(f"Expected a folder of reference sets, got the file {folder}.")
        if not path.exists():
            return ReferenceIndex(references=())
    return read_model(path, ReferenceIndex)


def load_reference(
    track: str, application: Application, folder: str | Path = FOLDER
) -> Reference | None:
    """Load the reference set of a track's id and its application's agent; None without one.

    Raises:
        ValueError: If the file cannot be read, is not the one that the index names, or is of
            another version of the environment or of the agent.
    """
    wanted = (track, application.agent_name)
    known = {(entry.track, entry.agent): entry for entry in read_index(folder).references}
    if wanted not in known:
        return None
    entry = known[wanted]
    path = Path(folder) / entry.file
    content = read_file(path, MAX_ARRAYS_BYTES)
    mu = reference_mu(len(application.parameters), entry.points, entry.sobol_seed)
    for what, expected, got in (
        ("SHA-256", entry.sha256, hashlib.sha256(content).hexdigest()),
        ("environment's version", entry.version, application.version),
        ("agent's fingerprint", entry.fingerprint, application.fingerprint),
        ("points' SHA-256", entry.mu_sha256, _mu_sha256(mu)),
    ):
        if expected != got:
            fix = "Restore the file, or make the set again with studies/reference_sets.py."
            if what == "agent's fingerprint" and could_be_canonical(arithmetic()):
                fix = "Import sada_gym before NumPy and torch, which round in another way here."
            raise UserError(
                f"Expected the reference set {path} with the {what} {expected}, got {got}. {fix}"
            )
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return Reference(entry, mu, arrays["fooled"], arrays["mean_score"])


def _mu_sha256(mu: Mu) -> str:
    return hashlib.sha256(np.ascontiguousarray(mu, dtype="<f4").tobytes()).hexdigest()
