"""Pictures of an entry's samples: where they lie, and worlds that fool the agent."""

from __future__ import annotations

import hashlib
import itertools
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sada_gym import __version__
from sada_gym.analyses.plots.attack import contact_sheet, marginals
from sada_gym.analyses.plots.style import png
from sada_gym.application import Application
from sada_gym.board.results.entry import EntryResult
from sada_gym.board.results.samples import samples_sha256
from sada_gym.errors import MissingExtra, MissingPart
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.cards import ApplicationCard
from sada_gym.foundations.files import read_file

MAX_FRAMES = 12
MAX_BYTES = 2**24
FOLDER = "pictures"
_VERSION = 1
"""Raise it when the pictures change, so that those of earlier builds are not taken again."""


@dataclass(frozen=True)
class SamplePicture:
    """A picture on an entry's page: its place in the site, and what it shows in words."""

    path: str
    text: str


@dataclass(eq=False)
class Pictures:
    """Draws pictures, and takes those that an earlier build drew of the same samples.

    `files` holds the pictures by their place in the site; `of` fills it.
    """

    drawing: bool
    earlier: Path
    files: dict[str, bytes] = field(default_factory=dict)

    def of(
        self, card: ApplicationCard, agent: str, results: Mapping[str, EntryResult]
    ) -> tuple[SamplePicture, ...]:
        """Draw the samples behind the results by track; tracks of the same parameters share one."""
        if not self.drawing:
            return ()
        try:
            opened = {
                track: result.experiment.target.open()
                for track, result in results.items()
                if result.samples
            }
        except (MissingExtra, MissingPart) as error:
            warnings.warn(f"No pictures of {card.title} are drawn. {error}", stacklevel=2)
            return ()
        applications = {track: target.application for track, target in opened.items()}
        pictures = []
        for tracks in _alike(applications):
            names = ", ".join(card.short(track) for track in tracks)
            samples = {
                track: Evaluations.joined(list(results[track].samples.values())) for track in tracks
            }
            digest = hashlib.sha256(f"{_VERSION} {__version__} {agent}".encode())
            for track in tracks:
                digest.update(f"{track} {samples_sha256(results[track].samples)}".encode())
            chosen = {track: applications[track] for track in tracks}
            for kind, draw, text in (
                ("marginals", _marginals, "Where the samples lie along each parameter."),
                ("fooled", _fooled, "Worlds that fool the agent."),
            ):
                path = f"{FOLDER}/{digest.hexdigest()[:32]}.{kind}.png"
                known = self.earlier / path
                if known.is_file():
                    content = read_file(known, MAX_BYTES)
                else:
                    content = draw(chosen, samples, card)
                if content:
                    self.files[path] = content
                    pictures.append(SamplePicture(path, f"{text} Tracks: {names}."))
        for target in opened.values():
            target.close()
        return tuple(pictures)


def _alike(applications: Mapping[str, Application]) -> Iterator[list[str]]:
    """Put tracks together whose parameters and thresholds are the same."""

    def key(track: str) -> str:
        application = applications[track]
        return repr((application.parameters.parameters, application.fooling_threshold))

    order = sorted(applications, key=key)
    for _, tracks in itertools.groupby(order, key):
        yield list(tracks)


def _marginals(
    applications: Mapping[str, Application], samples: Mapping[str, Evaluations], _: ApplicationCard
) -> bytes:
    application = next(iter(applications.values()))
    pooled = Evaluations.joined(list(samples.values()))
    return png(marginals(application.parameters, pooled, application.fooling_threshold))


def _fooled(
    applications: Mapping[str, Application],
    samples: Mapping[str, Evaluations],
    card: ApplicationCard,
) -> bytes:
    """Draw fooled worlds, in turn from each track."""
    by_track = [
        [(track, int(i)) for i in np.flatnonzero(samples[track].fooled(app.fooling_threshold))]
        for track, app in applications.items()
    ]
    in_turn = [world for turn in itertools.zip_longest(*by_track) for world in turn if world]
    chosen = in_turn[:MAX_FRAMES]
    try:
        frames = [
            applications[track].render(samples[track].mu[i], int(samples[track].seed[i]))
            for track, i in chosen
        ]
    except NotImplementedError as error:
        warnings.warn(f"No frames are drawn. {error}", stacklevel=2)
        return b""
    if not frames:
        return b""
    captions = [f"{card.short(track)}: Q = {samples[track].score[i]:.2f}" for track, i in chosen]
    threshold = next(iter(applications.values())).fooling_threshold
    title = f"Samples that fool the agent (Q ≤ {threshold:g}): {len(frames)} of {len(in_turn):,}"
    return png(contact_sheet(frames, captions, title))
