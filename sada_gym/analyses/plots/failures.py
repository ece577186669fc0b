"""Pictures of failures: chosen, drawn and captioned on one sheet."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import get_args

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.analyses.plots.failure_choice import ShownFailure, choose_failures
from sada_gym.analyses.plots.failure_sheet import FrameGroup, columns_for, failure_sheet
from sada_gym.application import Application, isolated_rng
from sada_gym.errors import described
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.frames import Frame, LegendEntry, Mark, as_frame
from sada_gym.parameters import ParameterSpace

_MOST_VALUES = 10


class NotDrawnError(Exception):
    """Drawing failed; the text goes on with why."""


def draw_failures(
    application: Application,
    samples: Evaluations,
    headline: str,
    on_progress: Callable[[int, int], None],
    on_frame: Callable[[int, Frame], None] = lambda sample, frame: None,  # noqa: ARG005
) -> Image.Image:
    """Draw the worst, typical and diverse failures: the first alone, all others in one batch.

    Some of the samples fool the agent. `on_progress` is called after each frame with the numbers of
    frames drawn and of all frames, and `on_frame` with the sample's row and the frame.

    Raises:
        NotDrawnError: If the application draws no frames, or its drawing fails.
    """
    space, threshold = application.parameters, application.fooling_threshold
    source = f"{type(application).__name__}.render"

    def frames(shown: Sequence[ShownFailure]) -> Iterator[Frame]:
        rows = [failure.sample for failure in shown]
        try:
            drawn = application.render_batch(samples.mu[rows], samples.seed[rows].tolist())
            for given, row in zip(drawn, rows, strict=True):
                frame = as_frame(given, source)
                on_frame(row, frame)
                yield frame
        except NotImplementedError as error:
            raise NotDrawnError(f". {error}") from error
        except Exception as error:  # drawing is a user's code, too, and must not cost the result
            raise NotDrawnError(f": {source} raised {described(error)}") from error

    with isolated_rng(application):
        (first,) = frames(choose_failures(space, samples, threshold, (1, 0, 0)).worst)
        legend = _legend(application)
        plain = all(entry.mark == "note" for entry in legend)
        columns = columns_for(first, plain=plain)
        counts = (columns, columns, 4 if columns == 2 else columns)  # whole rows
        chosen = choose_failures(space, samples, threshold, counts)
        pictures, total = [first], len(chosen.shown)
        on_progress(1, total)
        for frame in frames(chosen.shown[1:]) if total > 1 else ():
            pictures.append(frame)
            on_progress(len(pictures), total)
    rest, groups = iter(pictures), []
    told = None if application.frames_tell_values else space
    for name, note, failures in (
        ("Worst", "the lowest scores Q", chosen.worst),
        ("Typical", "each stands for the failures nearest to it", chosen.typical),
        ("Diverse", "those that are least like the others here", chosen.diverse),
    ):
        captions = [_caption(failure, samples, told) for failure in failures]
        groups.append(FrameGroup(name, note, [next(rest) for _ in failures], captions))
    fooled = int(samples.fooled(threshold).sum())
    title = (
        f"{total} of {fooled} samples that fool the agent (score Q ≤ {threshold:g}). "
        "#0 is the first row of samples.npz."
    )
    if any(failure.alike for failure in chosen.shown):
        title += " +1 alike: one more of them is hardly different."
    return failure_sheet(groups, columns, legend, title, headline)


def _legend(application: Application) -> tuple[LegendEntry, ...]:
    name = type(application).__name__
    try:
        entries = tuple(application.legend)
    except Exception as error:  # a user's code
        raise NotDrawnError(f": {name}.legend raised {described(error)}") from error
    for entry in entries:
        if (
            not isinstance(entry, LegendEntry)
            or entry.mark not in get_args(Mark)
            or not re.fullmatch("#[0-9a-fA-F]{6}", entry.colour)
        ):
            raise NotDrawnError(
                f": expected LegendEntry(text, '#rrggbb', mark) in {name}.legend, got {entry!r}"
            )
    return entries or (LegendEntry(f"Frames as {name} draws them."),)


def _caption(failure: ShownFailure, samples: Evaluations, space: ParameterSpace | None) -> str:
    parts = [f"#{failure.sample}: Q = {samples.score[failure.sample]:.2f}"]
    if failure.stands_for is not None:
        parts.append(f"stands for {100 * failure.stands_for:.0f} %")
    if failure.alike:
        parts.append(f"+{failure.alike} alike")
    line = ", ".join(parts)
    return line if space is None else f"{line}\n{_world(space, samples.mu[failure.sample])}"


def _world(space: ParameterSpace, mu: npt.NDArray[np.float32]) -> str:
    pairs = [*zip(space.parameters, space.physical(mu).tolist(), strict=True)]
    texts = [parameter.text(value) for parameter, value in pairs[:_MOST_VALUES]]
    return ", ".join(texts) + (", …" if len(space) > _MOST_VALUES else "")
