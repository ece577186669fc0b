"""Makes a run of worlds that are known already, such as those that stress testing found."""

from __future__ import annotations

from pathlib import Path

from sada_gym.analyses.diagnose import analyse
from sada_gym.analyses.pictures import draw_missing
from sada_gym.analyses.report.make import report_attack
from sada_gym.application import Application
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.algorithm import Algorithm1, ignore_progress
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import Experiment, Protocol, RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.files import as_path, file_errors, write_model
from sada_gym.run import Run, load_run
from sada_gym.run.folder import (
    RESULT_FILE,
    SAMPLES_FILE,
    RunRecord,
    reserve_folder,
    write_samples,
)
from sada_gym.run.given import Given


class _Known(Algorithm1):
    """Measures worlds that no adversary of ours has drawn."""

    worlds: Evaluations

    @property
    def samples(self) -> Evaluations:
        return self.worlds


def record(
    application: Application,
    worlds: Evaluations,
    out: str | Path,
    *,
    name: str = "stress testing",
    pictures: bool = True,
) -> Run:
    """Write worlds that you found into a folder, as the samples of a run.

    `replay`, `report`, `export` and `regress` accept this run like one of `attack`. It holds no
    adversary. Only the worlds that are described or drawn are evaluated again.

    Args:
        application: The application of the worlds; for `StressEnv` its `application`.
        worlds: At least one world, with score and seed, such as `StressEnv(...).failures`.
        out: The folder to write; it must hold no run.
        name: The name of your search in reports.
        pictures: Whether to draw pictures and write report.html.

    Raises:
        UserError: If there is no world, or the worlds do not belong to the application.
    """
    if not isinstance(worlds, Evaluations):
        raise UserTypeError(f"Expected worlds as Evaluations, got {worlds!r}.")
    if not len(worlds):
        raise UserError("Expected at least one world to record, got none. Search for longer.")
    application.parameters.validate(worlds.mu)
    folder = as_path(out, "the folder for the results")
    with OpenTarget.of(application) as opened:
        spec = AdversarySpec.of("random", None, None)
        solver = spec.make(opened.dimension, seed=0, ideal_set=None)
        experiment = Experiment(
            target=opened.target,
            adversary=spec.resolve(),
            protocol=Protocol(budget=0, samples=len(worlds)),
            seed=0,
        )
        used = packages(opened.application, type(solver))
        settings = RunSettings(experiment=experiment, label=name, packages=used)
        known = _Known(settings, solver, opened.evaluator, fooling_set=None, ideal_set=None)
        known.worlds = worlds
        result = known.measure()
        with file_errors("make the folder", folder):
            reserve_folder(
                folder, RunRecord(settings=settings, given=Given.of(application, {})), resume=False
            )
        write_samples(folder / SAMPLES_FILE, worlds)
        write_model(folder / RESULT_FILE, result)
        run = load_run(folder)
        analyse(run, opened, rules=False)
        frames = draw_missing(run, application, ignore_progress, anew=True) if pictures else {}
        report_attack(run, application, frames, html=pictures, on_progress=lambda *_: None)
    return load_run(folder)
