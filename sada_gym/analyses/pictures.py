"""Draws the pictures of an attack, unless an earlier call has drawn them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from sada_gym.evaluations import Evaluations
from sada_gym.experiment.algorithm import OnProgress, RunProgress
from sada_gym.foundations.files import file_errors, sync

if TYPE_CHECKING:
    from sada_gym.application import Application
    from sada_gym.foundations.frames import Frame
    from sada_gym.run import Run

_UNFINISHED = ".pictures.tmp"


def draw_missing(
    run: Run, application: Application, on_progress: OnProgress, *, anew: bool = False
) -> dict[int, Frame]:
    """Draw all pictures of an attack into its folder.

    Those that are there already stay as they are, unless all are to be drawn again.

    Returns:
        The frames that the sheet of failures shows, by the samples' rows; none where it was there.
    """
    folder = run.folder
    beside = folder / _UNFINISHED
    frames: dict[int, Frame] = {}
    are_whole = not beside.exists() and all(path.stat().st_size for path in run.pictures)
    if run.pictures and are_whole and not anew:
        return frames
    from sada_gym.analyses.plots.attack import draw_attack  # matplotlib

    on_progress(RunProgress("pictures"))
    diagnosis, queries = run.diagnosis, run.queries
    _empty(beside)
    try:
        draw_attack(
            application,
            run.samples,
            Evaluations.empty(run.samples.mu.shape[1]) if queries is None else queries,
            beside,
            headline="" if diagnosis is None else diagnosis.sentence,
            on_progress=lambda done, total: on_progress(RunProgress("pictures", done, total)),
            on_frame=frames.__setitem__,
        )
        sync(beside)
    except BaseException:
        _empty(beside)
        raise
    # moved when all are there; as long as this folder is there, a later call draws them again
    with file_errors("write", folder):
        for made in beside.iterdir():
            place = folder / made.name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            made.replace(place)
        beside.rmdir()
    return frames


def _empty(folder: Path) -> None:
    with file_errors("write the folder", folder):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
