"""Draws the pictures of a benchmark's folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.benchmark.folder import run_folder, slug
from sada_gym.benchmark.report.charts import (
    Curve,
    NoveltyRatios,
    anytime_curves,
    marginal_strips,
    novelty_ratios,
    tradeoff,
)
from sada_gym.benchmark.report.tables import short_name
from sada_gym.benchmark.results import MEANS, Results, RunSummary
from sada_gym.files import write_file
from sada_gym.measures.reference import FOLDER, load_reference
from sada_gym.parameters import Mu, ParameterSpace
from sada_gym.plots.style import png
from sada_gym.runs.assemble import open_application
from sada_gym.runs.ideal import IDEAL
from sada_gym.runs.record import SAMPLES_FILE, read_samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = "pictures"


def draw_benchmark(out: Path, results: Results, references: Path = FOLDER) -> None:
    """Draw the pictures of every table and agent into OUT/pictures.

    What needs a reference set, or training queries, is left out where there are none.

    Args:
        out: The benchmark's folder.
        results: The benchmark's results.
        references: The folder of the reference sets.
    """
    for name, figure in _figures(out, results, references):
        path = out / PICTURES / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, png(figure))


def _figures(out: Path, results: Results, references: Path) -> Iterator[tuple[str, Figure]]:
    titles = {table.name: table.title for table in results.settings.tables}
    worlds = _worlds(results, references)
    for table, agent in results.comparisons():
        folder = slug(f"{table}.{agent}" if agent else table)
        title = f"{titles[table]}, {agent}" if agent else titles[table]
        runs = [run for run in results.runs if (run.table, run.agent) == (table, agent)]
        tracks = list(dict.fromkeys(run.track for run in runs))
        over = short_name(tracks[0]) if len(tracks) == 1 else f"mean of {len(tracks)} tracks"
        rows = results.rows_of(table, agent, None)
        if placed := [row for row in rows if row.afr and row.relative_coverage]:
            yield f"{folder}/afr-coverage", tradeoff(placed, f"{title}: {over}")
        if curves := _curves(runs):
            yield f"{folder}/anytime", anytime_curves(curves, f"{title}: search, {over}")
        if ratios := _ratios(runs):
            yield f"{folder}/novelty", novelty_ratios(ratios, f"{title}: novelty of the samples")
        for track in tracks:
            space, fooling_set = worlds[track, agent]
            samples = _samples(out, [run for run in runs if run.track == track])
            if samples:
                figure = marginal_strips(
                    space, samples, fooling_set, f"{title}: where samples lie, {short_name(track)}"
                )
                yield f"{folder}/marginals-{slug(short_name(track))}", figure


def _worlds(
    results: Results, references: Path
) -> dict[tuple[str, str], tuple[ParameterSpace, Mu | None]]:
    """Give the parameters and the fooling set of everything that was attacked."""
    worlds = {}
    for target in results.targets:
        application = open_application(target.track, target.agent)
        summary = target.reference
        usable = summary is not None and summary.usable
        reference = load_reference(target.track, application, references) if usable else None
        fooling_set = None if reference is None else reference.fooling_set
        worlds[target.track, target.agent] = (application.parameters, fooling_set)
        application.close()
    return worlds


def _curves(runs: Sequence[RunSummary]) -> list[Curve]:
    """Average the searches of each contender over its tracks; equal curves become one."""
    found: dict[bytes, Curve] = {}
    for label in dict.fromkeys(run.label for run in runs):
        searched = [
            (run.track, run.search.curve) for run in runs if run.label == label and run.search
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
        labels = (*(found[key].labels if key in found else ()), label)
        found[key] = Curve(labels, np.array(queries, np.float64), mean, coverage)
    return list(found.values())


def _ratios(runs: Sequence[RunSummary]) -> list[NoveltyRatios]:
    there = []
    for label in dict.fromkeys(run.label for run in runs if run.label != IDEAL):
        measured = [run.measures for run in runs if run.label == label and run.measures]
        median, fifth, image = (
            [ratio for measures in measured if (ratio := MEANS[name].of(measures)) is not None]
            for name in ("novelty_ratio", "novelty_fifth_ratio", "image_novelty_ratio")
        )
        if median:
            there.append(NoveltyRatios(label, median, fifth, image))
    return there


def _samples(out: Path, runs: Sequence[RunSummary]) -> dict[str, Mu]:
    """Read the test samples of all seeds by contender."""
    parts: dict[str, list[Mu]] = {}
    for run in runs:
        if run.measures is not None:
            samples = read_samples(run_folder(out, run) / SAMPLES_FILE)
            parts.setdefault(run.label, []).append(samples.mu)
    return {label: np.concatenate(mu) for label, mu in parts.items()}
