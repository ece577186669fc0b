"""Makes report.html: one file with its pictures, data, style and program inside."""

from __future__ import annotations

import base64
import hashlib
import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym import __version__
from sada_gym.arrays import Indices
from sada_gym.evaluations import Evaluations
from sada_gym.report.paired import different_settings, pair
from sada_gym.report.run import ReportedRun
from sada_gym.report.thumbnails import fitting, sample
from sada_gym.report.views import RunView, data_uri
from sada_gym.report.worlds import weakness_of

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_WORLDS = 20_000
"""A page plots so many worlds; of more it plots some, evenly chosen, and says so."""
_MOST_BYTES = 1_500_000  # of their numbers

_FOLDER = Path(__file__).parent


def page(run: ReportedRun, other: ReportedRun | None = None) -> bytes:
    """Make the page of a run, or of two side by side."""
    if other is None:
        views = [RunView(replace(run, pictures=fitting(run.pictures)))]
        more: dict[str, Any] = {}
    else:
        run, other = (replace(one, pictures=fitting(one.pictures, 2)) for one in (run, other))
        views = [RunView(run, "A"), RunView(other, "B")]
        more = {"paired": pair(run, other), "differences": different_settings(run, other)}
    data = [_plotted(view, len(views)) for view in views]
    style, script = (_static(name) for name in ("report.css", "report.js"))
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; "
        f"script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'"
    )
    template = _environment().get_template("run.html" if other is None else "two.html")
    return template.render(
        views=views,
        view=views[0],
        data=_json(data),
        left_out=[one["left_out"] for one in data],
        style=style,
        script=script,
        policy=policy,
        version=__version__,
        **more,
    ).encode(errors="backslashreplace")


def _plotted(view: RunView, runs: int) -> dict[str, Any]:
    """Return what the page's program plots of a run, as JSON; arrays are little-endian base64."""
    run = view.run
    both = Evaluations.joined([run.samples, run.queries])
    bytes_each = 4 * (run.samples.mu.shape[1] + 2) + 2
    most = min(MOST_WORLDS, _MOST_BYTES // bytes_each) // runs
    rows = _evenly(len(run.samples), len(run.queries), most)
    worlds, count = both[rows], int((rows < len(run.samples)).sum())
    fooled = worlds.fooled(run.target.fooling_threshold)
    order = {name: i for i, name in enumerate(view.order)}
    pictures: dict[int, str] = {}
    for place, row in enumerate(rows[:count].tolist()):
        key = sample(run.samples, row).key
        if key in view.shown:
            pictures[place] = f"#{view.shown[key]}"
        elif key in run.pictures:
            pictures[place] = data_uri(run.pictures[key])
    return {
        "name": view.name,
        "letter": view.letter,
        "threshold": run.target.fooling_threshold,
        "replay": shlex.join(["sada-gym", "replay", run.name]),
        "parameters": [
            {**column.model_dump(), "label": column.parameter.label, "rank": order[column.name]}
            for column in run.columns.parameters
        ],
        "samples": count,
        "left_out": len(both) - len(rows),
        "rows": _pack(np.where(rows < len(run.samples), rows, rows - len(run.samples)), "<i4"),
        "mu": _pack(worlds.mu, "<f4"),
        "score": _pack(worlds.score, "<f4"),
        "seed": _pack(worlds.seed, "<i4"),
        "verdict": _pack(np.where(worlds.invalid, 2, fooled), "u1"),
        "weakness": _pack(weakness_of(run.rules, run.space, worlds.mu), "u1"),
        "weaknesses": [finding.text for finding in view.findings][: len(run.rules)],
        "behaviours": {
            place: run.told[row]
            for place, row in enumerate(rows[:count].tolist())
            if row in run.told
        },
        "pictures": pictures,
    }


def _evenly(samples: int, queries: int, most: int) -> Indices:
    """Choose at most so many worlds: the samples first, then the queries that follow them."""
    kept = min(samples, most)
    more = min(queries, most - kept)
    parts = ((0, samples, kept), (samples, queries, more))
    chosen = [start + np.linspace(0, max(0, n - 1), k).round() for start, n, k in parts]
    return np.concatenate(chosen).astype(np.intp)


def _pack(values: npt.NDArray[Any], dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode()


def _json(data: Sequence[Mapping[str, Any]]) -> str:
    """Write data so that no text in it can end the element that it stands in."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _hash(content: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}"


@cache
def _static(name: str) -> str:
    return (_FOLDER / "static" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(_FOLDER / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
