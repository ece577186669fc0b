"""Draws the pictures of an attack, unless an earlier call has drawn them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sada_gym.experiment.run import OnProgress, RunProgress
from sada_gym.files import file_errors, sync

if TYPE_CHECKING:
    from sada_gym.application import Application
    from sada_gym.evaluations import Evaluations
    from sada_gym.experiment.record import RunReport
    from sada_gym.frames import Frame

_UNFINISHED = ".pictures.tmp"


def draw_missing(
    application: Application,
    report: RunReport,
    samples: Evaluations,
    queries: Evaluations,
    folder: Path,
    on_progress: OnProgress,
    *,
    headline: str = "",
    anew: bool = False,
    on_frame: Callable[[int, Frame], None] = lambda sample, frame: None,  # noqa: ARG005
) -> tuple[Path, ...]:
    """Draw all pictures of an attack into its folder, and return their files.

    Those that are there already are returned as they are, unless all are to be drawn anew.
    The `headline` of the sheet of failures is by default the sentence of the figures. `on_frame`
    gets the frames of the sheet of failures, with the samples' rows.
    """
    known, beside = tuple(sorted(folder.glob("*.png"))), folder / _UNFINISHED
    are_whole = not beside.exists() and all(path.stat().st_size for path in known)
    if known and are_whole and not anew:
        return known
    from sada_gym.plots.attack import draw_attack  # matplotlib

    on_progress(RunProgress("pictures"))
    _empty(beside)
    try:
        drawn = draw_attack(
            application,
            samples,
            queries,
            beside,
            headline=headline or report.where.sentence,
            on_progress=lambda done, total: on_progress(RunProgress("pictures", done, total)),
            on_frame=on_frame,
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
    return tuple(folder / path.relative_to(beside) for path in drawn)


def _empty(folder: Path) -> None:
    with file_errors("write the folder", folder):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
