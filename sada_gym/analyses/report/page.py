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

from sada_gym.analyses.report.paired import compare, different_settings
from sada_gym.analyses.report.thumbnails import fitting, sample
from sada_gym.analyses.report.views import RunView, data_uri
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.packages import installed
from sada_gym.foundations.arrays import Indices
from sada_gym.run.worlds import weakness_of

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_WORLDS = 20_000
"""A page plots so many worlds; of more it plots some, evenly chosen, and says so."""
_MOST_BYTES = 1_500_000  # of their numbers

_FOLDER = Path(__file__).parent


def page(view: RunView, other: RunView | None = None) -> bytes:
    """Make the page of a run, or of two side by side."""
    more: dict[str, Any] = {}
    if other is None:
        views = [replace(view, pictures=fitting(view.pictures))]
    else:
        views = [
            replace(one, pictures=fitting(one.pictures, 2), letter=letter)
            for one, letter in ((view, "A"), (other, "B"))
        ]
        more = {"compared": compare(*views), "differences": different_settings(*views)}
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
        version=installed("sada_gym"),
        **more,
    ).encode(errors="backslashreplace")


def _plotted(view: RunView, runs: int) -> dict[str, Any]:
    """Return what the page's program plots of a run, as JSON; arrays are little-endian base64."""
    both = Evaluations.joined([view.samples, view.queries])
    bytes_each = 4 * (view.samples.mu.shape[1] + 2) + 2
    most = min(MOST_WORLDS, _MOST_BYTES // bytes_each) // runs
    rows = _evenly(len(view.samples), len(view.queries), most)
    worlds, count = both[rows], int((rows < len(view.samples)).sum())
    fooled = worlds.fooled(view.target.fooling_threshold)
    order = {name: i for i, name in enumerate(view.order)}
    pictures: dict[int, str] = {}
    for place, row in enumerate(rows[:count].tolist()):
        key = sample(view.samples, row).key
        if key in view.shown:
            pictures[place] = f"#{view.shown[key]}"
        elif key in view.pictures:
            pictures[place] = data_uri(view.pictures[key])
    return {
        "name": view.name,
        "letter": view.letter,
        "threshold": view.target.fooling_threshold,
        "replay": shlex.join(["sada-gym", "replay", view.place]),
        "parameters": [
            {**column.model_dump(), "label": column.parameter.label, "rank": order[column.name]}
            for column in view.columns.parameters
        ],
        "samples": count,
        "left_out": len(both) - len(rows),
        "rows": _pack(np.where(rows < len(view.samples), rows, rows - len(view.samples)), "<i4"),
        "mu": _pack(worlds.mu, "<f4"),
        "score": _pack(worlds.score, "<f4"),
        "seed": _pack(worlds.seed, "<i4"),
        "verdict": _pack(np.where(worlds.invalid, 2, fooled), "u1"),
        "weakness": _pack(weakness_of(view.rules, view.space, worlds.mu), "u1"),
        "weaknesses": [finding.text for finding in view.findings][: len(view.rules)],
        "behaviours": {
            place: view.told[row]
            for place, row in enumerate(rows[:count].tolist())
            if row in view.told
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
