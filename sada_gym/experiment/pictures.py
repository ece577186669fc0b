"""Draws the pictures of an attack, unless an earlier call has drawn them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from sada_gym.experiment.run import OnProgress, RunProgress
from sada_gym.files import file_errors

if TYPE_CHECKING:
    from sada_gym.application import Application
    from sada_gym.evaluations import Evaluations
    from sada_gym.experiment.record import RunReport

_UNFINISHED = ".pictures.tmp"


def draw_missing(
    application: Application,
    report: RunReport,
    samples: Evaluations,
    queries: Evaluations,
    folder: Path,
    on_progress: OnProgress,
    *,
    anew: bool = False,
) -> tuple[Path, ...]:
    """Draw all pictures of an attack into its folder, and return their files.

    Those that are there already are returned as they are, unless all are to be drawn anew.
    """
    known = tuple(sorted(folder.glob("*.png")))
    if known and not anew:
        return known
    from sada_gym.plots.attack import draw_attack  # matplotlib

    on_progress(RunProgress("pictures"))
    beside = folder / _UNFINISHED
    with file_errors("write the folder", beside):
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir()
    try:
        drawn = draw_attack(
            application,
            samples,
            queries,
            beside,
            headline=report.where.sentence,
            on_progress=lambda done, total: on_progress(RunProgress("pictures", done, total)),
        )
        # moved when all are there: a run that was stopped meanwhile draws them again
        with file_errors("write", folder):
            for made in beside.iterdir():
                place = folder / made.name
                if place.is_dir() and not place.is_symlink():
                    shutil.rmtree(place)
                made.replace(place)
        return tuple(folder / path.relative_to(beside) for path in drawn)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
