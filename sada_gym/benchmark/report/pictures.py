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
from sada_gym.benchmark.results import Results, RunSummary
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

_Point = tuple[int, float, float | None]  # queries, found, coverage


def draw_benchmark(out: Path, results: Results, references: Path = FOLDER) -> tuple[Path, ...]:
    """Draw the pictures of every table and agent into OUT/pictures.

    What needs a reference set, or training queries, is left out where there are none.

    Args:
        out: The benchmark's folder.
        results: The benchmark's results.
        references: The folder of the reference sets.

    Returns:
        The files written.
    """
    written = []
    for name, figure in _figures(out, results, references):
        path = out / PICTURES / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, png(figure))
        written.append(path)
    return tuple(written)


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
    """Average the searches of each contender; equal curves become one."""
    found: dict[tuple[_Point, ...], list[str]] = {}
    for label in dict.fromkeys(run.label for run in runs):
        searched = [run for run in runs if run.label == label and run.search]
        curves = [
            {point.queries: point for point in run.search.curve} for run in searched if run.search
        ]
        common = sorted(set.intersection(*map(set, curves))) if curves else []
        if not common:
            continue
        tracks = [run.track for run in searched]
        shares = np.array([1 / tracks.count(track) for track in tracks]) / len(set(tracks))
        values = []
        for queries in common:
            points = [of_run[queries] for of_run in curves]
            known = [p.coverage for p in points if p.coverage is not None]
            coverage = float(shares @ known) if len(known) == len(points) else None
            values.append((queries, float(shares @ [p.found for p in points]), coverage))
        found.setdefault(tuple(values), []).append(label)
    return [_curve(tuple(labels), values) for values, labels in found.items()]


def _curve(labels: tuple[str, ...], points: Sequence[_Point]) -> Curve:
    queries, found, covered = zip(*points, strict=True)
    coverage = None if None in covered else np.array(covered, np.float64)
    return Curve(labels, np.array(queries, np.float64), np.array(found), coverage)


def _ratios(runs: Sequence[RunSummary]) -> list[NoveltyRatios]:
    there = []
    for label in dict.fromkeys(run.label for run in runs):
        measured = [run.measures for run in runs if run.label == label and run.measures]
        in_mu = [m.novelty for m in measured if m.novelty]
        images = [m.image_novelty for m in measured if m.image_novelty]
        one = NoveltyRatios(
            label,
            [novelty.ratio for novelty in in_mu if novelty.ratio is not None],
            [novelty.fifth_ratio for novelty in in_mu if novelty.fifth_ratio is not None],
            [novelty.ratio for novelty in images if novelty.ratio is not None],
        )
        if one.median and label != IDEAL:
            there.append(one)
    return there


def _samples(out: Path, runs: Sequence[RunSummary]) -> dict[str, Mu]:
    """Read the test samples of all seeds by contender."""
    parts: dict[str, list[Mu]] = {}
    for run in runs:
        if run.measures is not None:
            samples = read_samples(run_folder(out, run) / SAMPLES_FILE)
            parts.setdefault(run.label, []).append(samples.mu)
    return {label: np.concatenate(mu) for label, mu in parts.items()}
