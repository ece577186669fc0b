"""What an attack writes down: its settings at the start, its result at the end."""

from __future__ import annotations

import io
import json
import os
import platform
import shutil
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError

from sada_gym.files import Strict, read_arrays, read_model, write_file, write_folder, write_model
from sada_gym.errors import FileError, UserError, UserTypeError
from sada_gym.evaluation.oracle import Evaluations

SETTINGS_FILE = "attack.json"
RESULT_FILE = "result.json"
SAMPLES_FILE = "samples.npz"
STORE_FILE = "run.sqlite"
ADVERSARY_FOLDER = "adversary"

_PACKAGES = (
    "sada_gym",
    "gymnasium",
    "numpy",
    "scipy",
    "scikit-learn",
    "torch",
    "stable-baselines3",
    "pybullet",
    "highway-env",
    "pymunk",
    "trimesh",
    "numba",
    "ribs",
    "pillow",
)


class AttackSettings(Strict):
    """All that decides an attack's result.

    Attributes:
        environment: The environment's id.
        application: The application's name.
        version: Its version.
        application_settings: Its resolved keywords.
        agent: What the agent under test is called.
        fingerprint: Its SHA-256.
        adversary: The adversary's name.
        preset: The named set of options it starts from, if any.
        options: The adversary's options.
        budget: Number of training queries.
        samples: Number of test samples (M in the paper).
        seed: Seed of the adversary and of the evaluation seeds.
        packages: Versions of what takes part: a run is not resumed with others.
    """

    environment: str
    application: str
    version: int
    application_settings: dict[str, Any]
    agent: str
    fingerprint: str
    adversary: str
    preset: str | None
    options: dict[str, Any]
    budget: int
    samples: int
    seed: int
    packages: dict[str, str]


class Distances(Strict):
    """Distances from the test samples to their nearest neighbours among some queries."""

    minimum: float
    median: float
    mean: float
    maximum: float


class TrainingReport(Strict):
    """What the training queries (Omega) gave; where they are uniform, the random rate."""

    queries: int
    fooled: int
    fooling_rate: float | None
    mean_score: float | None


class FeasibleRate(Strict):
    """The attack fooling rate over those test samples whose worlds a privileged agent masters.

    Attributes:
        worlds: How many they are.
        fooled: In how many of them the agent is fooled.
        afr: The share; None where there are none.
    """

    worlds: int
    fooled: int
    afr: float | None


class AttackReport(Strict):
    """The contents of result.json. No wall-clock times: a resumed run's file is the same.

    Attributes:
        settings: What was run.
        fooling_threshold: The agent is fooled where Q <= this.
        afr: The attack fooling rate, the share of test samples that fool the agent.
        afr_interval_95: Its Wilson interval.
        fooled: Number of test samples that fool the agent.
        mean_score: The test samples' mean Q.
        mu_std: Their spread; 0.577 where uniform.
        nearest_query: Distances to the nearest training query; None without queries.
        nearest_fooling_query: Distances to the nearest one that fooled the agent.
        training: What training saw.
        seeds: How the seeds follow from the settings' one.
        flags: What the adversary says of its training, such as that no point fooled.
        feasible: The rate over feasible worlds; None where no privileged agent is known.
    """

    settings: AttackSettings
    fooling_threshold: float
    afr: float
    afr_interval_95: tuple[float, float]
    fooled: int
    mean_score: float
    mu_std: float
    nearest_query: Distances | None
    nearest_fooling_query: Distances | None
    training: TrainingReport
    seeds: dict[str, str | int]
    flags: tuple[str, ...]
    feasible: FeasibleRate | None = None


def feasible_rate(
    fooled: npt.NDArray[np.bool_], feasible: npt.NDArray[np.bool_] | None
) -> FeasibleRate | None:
    """Sum up `Application.feasible`.

    Args:
        fooled: (M,) which test samples fool the agent.
        feasible: (M,) which of them a privileged agent masters; None where none is known.
    """
    if feasible is None:
        return None
    worlds, both = int(feasible.sum()), int((fooled & feasible).sum())
    return FeasibleRate(worlds=worlds, fooled=both, afr=both / worlds if worlds else None)


def packages() -> dict[str, str]:
    """Give the versions of Python and of the installed packages that can change a result."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def write_samples(path: Path, samples: Evaluations) -> None:
    """Write test samples as NPZ: mu (n, d) float32, score (n,) float64, seed (n,) int64."""
    buffer = io.BytesIO()
    np.savez(buffer, mu=samples.mu, score=samples.score, seed=samples.seed)
    write_file(path, buffer.getvalue())


def read_samples(path: Path) -> Evaluations:
    """Read test samples that `write_samples` wrote.

    Raises:
        FileError: If the file cannot be read or does not hold such samples.
    """
    arrays = read_arrays(path, {"mu": ("f4", 2), "score": ("f8", 1), "seed": ("i8", 1)})
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) > 1:
        raise FileError(
            f"Expected as many mu as scores and seeds in {path}, got {counts}. "
            "Restore the file, or make it anew."
        )
    return Evaluations(arrays["mu"], arrays["score"], arrays["seed"])


def json_compatible(options: Mapping[str, Any]) -> dict[str, Any]:
    """Copy an adversary's options as JSON would hold them.

    Raises:
        TypeError: If they cannot be written as JSON.
    """
    try:
        copied: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise UserTypeError(
            f"Expected options that can be written as JSON, got {dict(options)!r} ({error}). "
            "Give numbers, strings, lists, None."
        ) from error
    return copied


def claim_folder(folder: Path, settings: AttackSettings, *, resume: bool) -> None:
    """Make a folder an attack's own by writing its settings there, or find them there.

    Raises:
        ValueError: If it holds another run, or the same one and `resume` is not set. Nothing is
            changed then.
    """
    path = folder / SETTINGS_FILE
    if folder.exists() and not folder.is_dir():
        raise UserError(f"Expected a folder for the results, got the file {folder}. Name another.")
    if path.exists():
        if not resume:
            raise UserError(
                f"Expected a new folder for the results, got {folder}, which holds a run. "
                "Resume that run with --resume (resume=True), or name another folder."
            )
        _refuse_other(folder, read_model(path, AttackSettings), settings)
        return
    for name in (RESULT_FILE, SAMPLES_FILE, STORE_FILE, ADVERSARY_FOLDER):
        if (folder / name).exists():
            raise UserError(
                f"Expected {folder} to hold no results, got {name} in it without the "
                f"{SETTINGS_FILE} that tells what run it is of. Name another folder."
            )
    folder.mkdir(parents=True, exist_ok=True)
    write_model(path, settings)


def _refuse_other(folder: Path, old: AttackSettings, new: AttackSettings) -> None:
    before, now = old.model_dump(mode="json"), new.model_dump(mode="json")
    changes = [f"{k} was {before[k]!r} and is {now[k]!r}" for k in before if before[k] != now[k]]
    if changes:
        raise UserError(
            f"Expected the settings that the run in {folder} was started with, got others: "
            f"{'; '.join(changes)}. Give the same ones, or name another folder."
        )
