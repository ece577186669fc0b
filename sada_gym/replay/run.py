"""Reads a run's folder: opens the application that was attacked, and chooses samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, UserTypeError, check_integer
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.folder import SAMPLES_FILE, SETTINGS_FILE, read_samples
from sada_gym.experiment.record import RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.files import as_path, read_model, shown


def read_run(run: str | Path) -> tuple[RunSettings, Evaluations]:
    """Read the settings and the test samples of a run.

    Raises:
        FileError: If the folder holds no run, the run is not finished, or a file is damaged.
    """
    folder = as_path(run, "a run's folder")
    if not (folder / SETTINGS_FILE).is_file():
        raise FileError(
            f"Expected a folder that `sada-gym attack` wrote, got {folder}, which holds no "
            f"{SETTINGS_FILE}. Name the folder that --out (out=) named."
        )
    settings = read_model(folder / SETTINGS_FILE, RunSettings)
    if not (folder / SAMPLES_FILE).exists():
        raise FileError(
            f"Expected the run in {folder} to be finished, got no {SAMPLES_FILE} in it. Finish it "
            "with --resume (resume=True)."
        )
    samples = read_samples(folder / SAMPLES_FILE)
    if not len(samples):
        raise FileError(f"Expected samples in {folder / SAMPLES_FILE}, got none.")
    return settings, samples


def choose(samples: Evaluations, *, worst: int | None, sample: int | None) -> list[int]:
    """Return the rows of the `worst` samples, None for the very worst, or the one `sample`.

    Raises:
        UserError: If both are given, or there are not as many samples.
    """
    if worst is not None and sample is not None:
        raise UserError("Expected the number of worst samples or one sample, got both.")
    if sample is not None:
        check_integer("sample", sample, 0, len(samples) - 1)
        return [int(sample)]
    count = 1 if worst is None else worst
    check_integer("worst", count, 1, len(samples))
    rows: list[int] = np.argsort(samples.score, kind="stable")[:count].tolist()
    return rows


def open_target(settings: RunSettings, folder: Path, given: Application | str | None) -> OpenTarget:
    """Open what a run attacked, and check that it is the same application, agent and version.

    `given` is the application, an environment's id or a TOML file; None takes what the settings
    name. Messages name the run's folder.

    Raises:
        UserError: If it cannot be opened, or differs.
    """
    if not isinstance(given, Application | str | None):
        raise UserTypeError(
            f"Expected an Application, an environment's id or a TOML file, got {given!r}."
        )
    target = settings.experiment.target
    if given is None and {"environment", "order"} <= set(target.application.settings):
        raise UserError(
            f"Expected a run whose settings can open what it attacked, got that of {folder}: it "
            f"attacked {shown(target.track)} in an application of yours. {_mend(folder)}"
        )
    try:
        return target.open(given)
    except UserError as error:
        raise UserError(
            f"Expected to open {shown(str(target))} as the run in {folder} did, but: {error} "
            f"{_mend(folder)}"
        ) from error


def _mend(folder: Path) -> str:
    return (
        "If a TOML file describes it, name that by --application FILE.toml. If you made it in "
        f"Python: sada_gym.replay.replay({str(folder)!r}, application=YOURS, out='failure.gif')."
    )
