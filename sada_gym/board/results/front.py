"""The chart of AFR against coverage, with the front: who is beaten by nobody in both."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from sada_gym.board.results.figures import Figure
from sada_gym.board.results.rows import Row, front_of
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.frames import BLUE

WIDTH, HEIGHT = 800, 560
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, WIDTH - 8, 50, HEIGHT - 68
_LETTER, _LINE = 8.0, 15.0  # a letter's usual width and a line's height, of 13 or 14 px text
_LEADER_FROM = 12.0
_MARKS = {
    "s": "M-5 -5H5V5H-5Z",
    "o": "M-5.5 0A5.5 5.5 0 1 0 5.5 0A5.5 5.5 0 1 0 -5.5 0Z",
    "^": "M0 -6.5L6.5 5H-6.5Z",
    "v": "M0 6.5L6.5 -5H-6.5Z",
    "D": "M0 -7L6 0L0 7L-6 0Z",
}
_STYLE = """\
svg { background: #fff; font: 13px system-ui, "DejaVu Sans", sans-serif; }
text { fill: #1d2329; } .grid { stroke: #e3e1dc; } .tick, .axis, .title { fill: #5d6873; }
.tick { font-size: 12px; } .interval { stroke: #5d6873; opacity: .45; }
.leader { stroke: currentColor; opacity: .8; }
.point text { fill: currentColor; paint-order: stroke; stroke: #fff; stroke-width: 3px; }
.steps { fill: none; stroke: #b23a0a; stroke-width: 1.5; stroke-dasharray: 5 4; opacity: .7; }
.dot { stroke: #fff; stroke-width: 1.2; } .best text { font-weight: 650; }
.control text { font-style: italic; }
"""

_RADII = (9, 16, 25, 36, 50, 66, 86, 108, 133, 160, 195)
# diagonals first: error bars lie along the axes
_ALL_ROUND = np.pi / 8 * np.array([2, 6, 14, 10, 1, 7, 15, 9, 3, 5, 13, 11, 0, 8, 4, 12])
_DOT = 6.0  # half the side of the square that a point takes
_MARGIN = 2.0
_ALONG = np.linspace(0.0, 1.0, 8)[:, None]  # the places of a leader that are looked at


@dataclass(frozen=True)
class Family:
    """Adversaries that charts draw alike.

    Attributes:
        name: What the legend calls them.
        colour: Their colour; all are distinct for colour-blind readers too (Okabe and Ito 2008).
        marker: Their mark as Matplotlib names it, which tells them apart without any colour.
        members: Their labels.
    """

    name: str
    colour: str
    marker: str
    members: frozenset[str] = frozenset()


FAMILIES = (
    Family("controls", "#6b7785", "s", frozenset({"ideal", "memorise"})),
    Family(
        "the paper's baselines",
        BLUE,
        "o",
        frozenset({"random", "svm", "gp", "gaussian", "gmm10", "gmm50", "bayesian"}),
    ),
    Family(
        "BBGAN",
        "#b84a00",
        "^",
        frozenset({"bbgan", "bbgan (paper)", "bbgan-boost", "bbgan-boost (paper)"}),
    ),
    Family("RL", "#a4447c", "D", frozenset({"reinforce", "ppo", "sac", "td3"})),
    Family("other methods", "#00795a", "v"),
)


def family_of(label: str) -> Family:
    """Return the family of an adversary by its label."""
    return next((family for family in FAMILIES if label in family.members), FAMILIES[-1])


@dataclass(frozen=True)
class Point:
    """An adversary in the chart.

    Attributes:
        front: Whether no other ranked adversary has both a higher AFR and a higher coverage.
        x: Its distance in pixels from the left; coverage grows to the right.
        y: Its distance in pixels from the top; the AFR grows upwards.
        bars: The ends of its 95 % intervals, (x1, y1, x2, y2).
        label_x: The middle of its label in pixels; `label_y` likewise.
    """

    row: Row
    coverage: Figure
    afr: Figure
    front: bool
    x: float
    y: float
    bars: tuple[tuple[float, float, float, float], ...]
    label_x: float
    label_y: float


@dataclass(frozen=True)
class FrontChart:
    """The chart of AFR against coverage.

    Attributes:
        front: The points on the front, from the highest AFR to the highest coverage.
        end: The highest coverage in the chart, from 0 to 1.
        floor: The lowest AFR in the chart, from 0 to 1; `start` is the lowest coverage.
    """

    title: str
    points: tuple[Point, ...]
    front: tuple[Point, ...]
    end: float
    floor: float
    start: float = 0.0

    @property
    def summary(self) -> str:
        """The front in words."""
        names = ", ".join(point.row.label for point in self.front)
        if not names:
            return ""
        return f"On the front, from the highest AFR to the highest coverage: {names}."

    def svg(self, root: str | None = None) -> str:
        """Return the chart as SVG.

        Args:
            root: For a chart within a page, the path from the page to the site's root: its points
                then link to the entries, and the page's style sheet applies. None for a file.
        """
        size = f'viewBox="0 0 {WIDTH} {HEIGHT}"'
        if root is None:
            size += f' xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}"'
        label = escape(f"{self.title}. {self.summary}".strip())
        parts = [f'<svg {size} role="img" aria-label="{label}">']
        if root is None:
            parts += [f"<style>\n{_STYLE}</style>", _text(_LEFT, 20, "title", self.title)]
        parts += [*self._grid(), *self._steps()]
        for point in self.points:
            parts += _drawn(point, root)
        return "\n".join((*parts, *self._legend(), "</svg>")) + "\n"

    def _grid(self) -> Iterator[str]:
        step = 0.2 if self.end <= 1.4 else 0.5
        for share in np.arange(self.start, self.end + 1e-9, step / (2 if self.start else 1)):
            x = _across(share, self.end, self.start)
            yield f'<line class="grid" x1="{x}" x2="{x}" y1="{_TOP}" y2="{_BOTTOM}"/>'
            yield _text(x, _BOTTOM + 18, "tick", f"{100 * share:.0f}", "middle")
        for share in np.arange(self.floor, 1.0 + 1e-9, 0.2 if self.floor < 0.4 else 0.1):
            y = _up(share, self.floor)
            yield f'<line class="grid" x1="{_LEFT}" x2="{_RIGHT}" y1="{y}" y2="{y}"/>'
            yield _text(_LEFT - 8, y + 4, "tick", f"{100 * share:.0f}", "end")
        across = "coverage of the known failures, % of ideal →"
        yield _text(_RIGHT, _BOTTOM + 36, "axis", across, "end")
        yield _text(_LEFT, _TOP - 8, "axis", "↑ attack fooling rate, %")

    def _steps(self) -> Iterator[str]:
        """Draw the border of what the front dominates."""
        if self.front:
            first, *others = self.front
            path = f"M{_LEFT} {first.y} H{first.x}"
            path += "".join(f" V{point.y} H{point.x}" for point in others)
            yield f'<path class="steps" d="{path} V{_BOTTOM}"/>'

    def _legend(self) -> Iterator[str]:
        x = float(_LEFT)
        shown = {family_of(point.row.label) for point in self.points}
        for family in FAMILIES:
            if family in shown:
                yield _mark(family, x + 6, HEIGHT - 14)
                yield _text(x + 16, HEIGHT - 10, "axis", family.name)
                x += 36 + _LETTER * len(family.name)


def make_chart(rows: Sequence[Row], title: str, start: float = 0.0) -> FrontChart | None:
    """Make the chart of the adversaries that have both figures; None for fewer than two.

    Those with a coverage below `start` are left out.
    """
    known = [
        (row, row.relative_coverage, row.afr) for row in rows if row.afr and row.relative_coverage
    ]
    shown = [one for one in known if one[1].value >= start]
    if len(shown) < 2:
        return None
    front = front_of(rows)
    shown.sort(key=lambda one: front.get(one[0].entry, False))  # those on it above the others
    end = max(1.0, *(_ends(coverage)[1] for _, coverage, _ in shown))
    lowest = min(_ends(afr)[0] for _, _, afr in shown)
    floor = max(0.0, math.floor(10 * lowest - 0.5) / 10)
    places = [
        (_across(coverage.value, end, start), _up(afr.value, floor)) for _, coverage, afr in shown
    ]
    sizes = np.array([(_width(row.label), _LINE) for row, _, _ in shown])
    labels = place_labels(np.array(places), sizes, (_LEFT, _TOP, _RIGHT, _BOTTOM))
    points = []
    for (row, coverage, afr), (x, y), label in zip(shown, places, labels.tolist(), strict=True):
        bars = []
        if coverage.interval_95:
            low, high = coverage.interval_95
            left = _across(max(low, start), end, start)
            bars.append((left, y, _across(high, end, start), y))
        if afr.interval_95:
            low, high = afr.interval_95
            bars.append((x, _up(max(low, 0.0), floor), x, _up(min(high, 1.0), floor)))
        label_x, label_y = (round(middle, 1) for middle in label)
        is_on_front = front.get(row.entry, False)
        points.append(Point(row, coverage, afr, is_on_front, x, y, tuple(bars), label_x, label_y))
    on_front = sorted((point for point in points if point.front), key=lambda point: point.x)
    return FrontChart(title, tuple(points), tuple(on_front), end, floor, start)


def _ends(figure: Figure) -> tuple[float, float]:
    return figure.interval_95 or (figure.value, figure.value)


def _across(coverage: float, end: float, start: float) -> float:
    share = (float(coverage) - start) / (end * 1.12 - start)
    return round(_LEFT + (_RIGHT - _LEFT) * share, 1)


def _up(rate: float, floor: float) -> float:
    share = (float(rate) - floor) / (1.0 - floor)
    return round(_BOTTOM - (_BOTTOM - _TOP) * share / 1.06, 1)


def _drawn(point: Point, root: str | None) -> Iterator[str]:
    family = family_of(point.row.label)
    kinds = ("control" if point.row.control else "", "best" if point.front else "")
    afr, coverage = f"{100 * point.afr.value:.1f} %", f"{100 * point.coverage.value:.1f} %"
    title = escape(f"{point.row.label}: AFR {afr}, coverage {coverage} of ideal")
    classes = " ".join(filter(None, ("point", *kinds)))
    if root is None:
        yield f'<g class="{classes}" style="color: {family.colour}">'
    else:
        href = escape(f"{root}entries/{point.row.entry}.html")
        yield f'<a href="{href}" class="{classes}" aria-label="{title}">'
    yield f"<title>{title}</title>"
    for x1, y1, x2, y2 in point.bars:
        yield f'<line class="interval" x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"/>'
    dx, dy = point.label_x - point.x, point.label_y - point.y
    edge_x = max(abs(dx) - _width(point.row.label) / 2, 0.0)
    edge_y = max(abs(dy) - _LINE / 2, 0.0)
    if np.hypot(edge_x, edge_y) > _LEADER_FROM:
        x, y = point.x + np.sign(dx) * edge_x, point.y + np.sign(dy) * edge_y
        yield f'<line class="leader" x1="{point.x}" y1="{point.y}" x2="{x:.1f}" y2="{y:.1f}"/>'
    yield _mark(family, point.x, point.y)
    yield _text(point.label_x, point.label_y + 4.5, "", point.row.label, "middle")
    yield "</g>" if root is None else "</a>"


def _mark(family: Family, x: float, y: float) -> str:
    shape = f'd="{_MARKS[family.marker]}" fill="{family.colour}"'
    return f'<path class="dot" transform="translate({x} {y})" {shape}/>'


def _text(x: float, y: float, kind: str, text: str, anchor: str = "start") -> str:
    attribute = f' class="{kind}"' if kind else ""
    return (
        f'<text{attribute} x="{x}" y="{round(y, 1)}" text-anchor="{anchor}">{escape(text)}</text>'
    )


def place_labels(
    anchors: Floats, sizes: Floats, frame: tuple[float, float, float, float]
) -> Floats:
    """Find a place for the name of each point: free of others, and nearest to its own point.

    The last points choose first.

    Args:
        anchors: (n, 2), the points in pixels.
        sizes: (n, 2), the widths and heights of the names in pixels.
        frame: The left, top, right and bottom within which the names have to be.

    Returns:
        (n, 2), the middles of the names in pixels.
    """
    directions = np.stack([np.cos(_ALL_ROUND), np.sin(_ALL_ROUND)], axis=1)
    dots = np.concatenate([anchors - _DOT, anchors + _DOT], axis=1)
    boxes, lines = np.zeros((len(anchors), 4)), np.zeros((len(anchors), len(_ALONG), 2))
    order = [*range(len(anchors))][::-1]
    for i in (*order, *order, *order):  # again, now that the others have a place
        half, others = sizes[i] / 2 + _MARGIN, np.arange(len(anchors)) != i
        offsets = directions * np.array(_RADII)[:, None, None] + np.sign(directions.round(6)) * half
        places = anchors[i] + offsets.reshape(-1, 2)
        low, high = places - half, places + half
        taken = np.concatenate([boxes[others], dots])
        sides = np.minimum(high[:, None], taken[:, 2:]) - np.maximum(low[:, None], taken[:, :2])
        overlap = np.prod(np.maximum(sides, 0.0), axis=2).sum(axis=1)
        outside = np.maximum(frame[:2] - low, 0.0) + np.maximum(high - frame[2:], 0.0)
        gaps = np.maximum(np.abs(places[:, None] - anchors) - half, 0.0)
        away = np.linalg.norm(gaps, axis=2)
        misread = np.maximum(away[:, [i]] + _DOT - away[:, others], 0.0).max(axis=1, initial=0.0)
        leaders = anchors[i] + _ALONG * (np.clip(anchors[i], low, high) - anchors[i])[:, None]
        blocks = np.concatenate([boxes[others], dots[others]])
        crossed = _inside(leaders[:, :, None], blocks[:, :2], blocks[:, 2:])
        crossed += _inside(lines[others], low[:, None, None], high[:, None, None])
        cost = 100 * (overlap + outside.sum(axis=1)) + away[:, i] + 2 * misread + 30 * crossed
        best = np.argmin(cost)  # the first of equal ones
        boxes[i], lines[i] = np.concatenate([low[best], high[best]]), leaders[best]
    return (boxes[:, :2] + boxes[:, 2:]) / 2


def _inside(points: Floats, low: Floats, high: Floats) -> Floats:
    """Count, for each place of a name, the points that lie within boxes."""
    inside = np.logical_and(points > low, points < high).all(axis=-1)
    return np.asarray(inside.sum(axis=(1, 2)), np.float64)


def _width(label: str) -> float:
    """Return about how wide a name is, in pixels: an m is half as wide again as other letters."""
    return _LETTER * (len(label) + 0.6 * label.count("m"))
