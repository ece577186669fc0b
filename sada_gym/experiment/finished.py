"""Opens a finished run: its settings, its test samples, and what it attacked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, UserTypeError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.folder import SAMPLES_FILE, SETTINGS_FILE, SOURCE_FILE, read_samples
from sada_gym.experiment.record import RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.files import MAX_TOML_BYTES, as_path, read_file, read_model, shown


def run_folders(runs: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the folders of a run, or of several; a UserError for anything else, or for none."""
    listed = [runs] if isinstance(runs, str | Path) else runs
    if not isinstance(listed, Sequence) or not all(isinstance(run, str | Path) for run in listed):
        raise UserTypeError(f"Expected a run's folder or a list of them, got {runs!r}.")
    if not listed:
        raise UserError("Expected at least one run, got none. Name the folder of one.")
    return [as_path(run, "a run's folder") for run in listed]


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


def source_of(folder: Path) -> str | None:
    """Return the TOML file that described what a run attacked; None where no file did."""
    source = folder / SOURCE_FILE
    return os.fsdecode(read_file(source, MAX_TOML_BYTES)).strip() if source.is_file() else None


def check_samples(samples: Evaluations, opened: OpenTarget) -> None:
    """Raise a UserError for samples of another number of parameters than an application has."""
    if samples.mu.shape[1] != opened.dimension:
        raise UserError(
            f"Expected samples of {opened.dimension} parameters, got {samples.mu.shape[1]}. The "
            f"run's {SAMPLES_FILE} is of another run."
        )


def open_target(
    settings: RunSettings,
    folder: Path,
    given: Application | str | None,
    *,
    call: str,
    workers: int = 1,
) -> OpenTarget:
    """Open what a run attacked, and check that it is the same application, agent and version.

    `given` is the application, an environment's id or a TOML file; None takes the TOML file or the
    track that was attacked. Messages name the run's folder, and the Python `call` that takes
    `application=YOURS`.

    Raises:
        UserError: If it cannot be opened, or differs.
    """
    if not isinstance(given, Application | str | None):
        raise UserTypeError(
            f"Expected an Application, an environment's id or a TOML file, got {given!r}."
        )
    mend = (
        "If a TOML file describes it, name that by --application FILE.toml. If you made it in "
        f"Python: {call}."
    )
    target = settings.experiment.target
    if given is None:
        given = source_of(folder)
    if given is None and {"environment", "order"} <= set(target.application.settings):
        raise UserError(
            f"Expected a run whose settings can open what it attacked, got that of {folder}: it "
            f"attacked {shown(target.track)} in an application of yours. {mend}"
        )
    try:
        return target.open(given, workers=workers)
    except UserError as error:
        raise UserError(
            f"Expected to open {shown(str(target))} as the run in {folder} did, but: {error} {mend}"
        ) from error
