"""Draws the pictures of a benchmark's folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.analyses.plots.style import png
from sada_gym.board.benchmark.folder import picture_folder
from sada_gym.board.benchmark.results import Results
from sada_gym.board.benchmark.tables import short_name
from sada_gym.board.results.charts import (
    NOVELTY_PANELS,
    Curve,
    anytime_curves,
    marginal_strips,
    novelty_ratios,
)
from sada_gym.board.results.entry import Entry
from sada_gym.board.results.front import make_chart
from sada_gym.board.results.rows import MEANS, RunSummary
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import slug
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.files import write_file
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Targets = Mapping[tuple[str, str], OpenTarget]
"""Targets that are closed again, by track and agent."""


def draw_benchmark(out: Path, results: Results, entries: Sequence[Entry], targets: Targets) -> None:
    """Draw the pictures of every table and agent into OUT/pictures.

    Without a reference set or training queries, the pictures that need them are left out.
    """
    for path, content in _pictures(out, results, entries, targets):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content if isinstance(content, bytes) else png(content))


def _pictures(
    out: Path, results: Results, entries: Sequence[Entry], targets: Targets
) -> Iterator[tuple[Path, Figure | bytes]]:
    for comparison in results.comparisons:
        agent, runs, tracks = comparison.agent, comparison.runs, comparison.tracks
        folder = picture_folder(out, comparison.table.name, agent)
        title = ", ".join(comparison.names)
        over = short_name(tracks[0]) if len(tracks) == 1 else f"mean of {len(tracks)} tracks"
        if chart := make_chart(comparison.rows, f"{title}: {over}"):
            yield folder / "afr-coverage.svg", chart.svg().encode()
        if curves := _curves(runs):
            yield folder / "anytime.png", anytime_curves(curves, f"{title}: search, {over}")
        if ratios := _ratios(runs):
            yield folder / "novelty.png", novelty_ratios(ratios, f"{title}: novelty of the samples")
        for track in tracks:
            target, name = targets[track, agent], short_name(track)
            samples = _samples(entries, [run for run in runs if run.track == track])
            if samples:
                above = f"{title}: where samples lie, {name}"
                strips = marginal_strips(target.parameters, samples, target.fooling_points, above)
                yield folder / f"marginals-{slug(name)}.png", strips


def _curves(runs: Sequence[RunSummary]) -> list[Curve]:
    """Average the searches of each adversary over its tracks; equal curves become one."""
    curves: dict[bytes, Curve] = {}
    for label in dict.fromkeys(run.label for run in runs):
        searched = [
            (run.track, run.claims.search.curve)
            for run in runs
            if run.label == label and run.claims.search
        ]
        points = [{point.queries: point for point in curve} for _, curve in searched]
        queries = sorted(set.intersection(*map(set, points))) if points else []
        if not queries:
            continue
        tracks = [track for track, _ in searched]
        shares = np.array([1 / tracks.count(track) for track in tracks]) / len(set(tracks))
        of_runs = [[of_run[count] for of_run in points] for count in queries]
        mean = np.array([shares @ [point.found for point in row] for row in of_runs])
        covered = np.array([[point.coverage for point in row] for row in of_runs], np.float64)
        coverage = None if np.isnan(covered).any() else np.array([shares @ row for row in covered])
        key = np.array([queries, mean, mean if coverage is None else coverage]).tobytes()
        labels = (*(curves[key].labels if key in curves else ()), label)
        curves[key] = Curve(labels, np.array(queries, np.float64), mean, coverage)
    return list(curves.values())


def _ratios(runs: Sequence[RunSummary]) -> dict[str, dict[str, list[float]]]:
    ratios_of = {}
    for label in dict.fromkeys(run.label for run in runs if run.label != IDEAL):
        measured = [run.measures for run in runs if run.label == label and run.measures]
        ratios = {
            name: [r for measures in measured if (r := MEANS[name].read(measures)) is not None]
            for name in NOVELTY_PANELS
        }
        if ratios["novelty_ratio"]:
            ratios_of[label] = ratios
    return ratios_of


def _samples(entries: Sequence[Entry], runs: Sequence[RunSummary]) -> dict[str, Mu]:
    """Return the test samples of all seeds by adversary."""
    of_entry = {entry.metadata.name: entry for entry in entries}
    parts: dict[str, list[Mu]] = {}
    for run in runs:
        if run.measures is not None:
            result = of_entry[run.entry].results[run.experiment.place]
            samples = result.samples[run.claims.seed]
            parts.setdefault(run.label, []).append(samples.mu)
    return {label: np.concatenate(mu) for label, mu in parts.items()}
