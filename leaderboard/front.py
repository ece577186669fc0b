"""The chart of AFR against coverage: where everything goes, for a template to draw as SVG."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from sada_gym.results.rows import Row

WIDTH, HEIGHT = 720, 440
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 16, 16, 52
Box = tuple[float, float, float, float]
"""The left, top, right and bottom of a box, or the two ends of a line."""

Scale = Callable[[float], float]
"""Tells where a figure goes on the page."""

_LETTER, _LINE = 7.6, 15  # a letter's usual width and a line's height, of 13 px text


@dataclass(frozen=True)
class Point:
    """A contender.

    Attributes:
        label: Its label.
        entry: The name of its entry.
        control: Whether it is a control.
        front: Whether no other ranked contender has both a higher AFR and a higher coverage.
        x: Its place from the left; coverage grows to the right.
        y: Its place from the top; the AFR grows upwards.
        bars: The ends of its 95 % intervals, (x1, y1, x2, y2).
        text_x: Where its label is anchored.
        text_y: The label's base line.
        anchor: The side of the label that is anchored; empty where there is no room for it.
        title: Its figures in words.
    """

    label: str
    entry: str
    control: bool
    front: bool
    x: float
    y: float
    bars: tuple[Box, ...]
    text_x: float
    text_y: float
    anchor: str
    title: str


@dataclass(frozen=True)
class Tick:
    """A line of the grid: its place and its label."""

    at: float
    label: str


@dataclass(frozen=True)
class Chart:
    """The chart.

    Attributes:
        points: The contenders.
        path: The steps along the front, as an SVG path; empty without one.
        x_ticks: The vertical lines of the grid.
        y_ticks: The horizontal ones.
        summary: The front in words.
    """

    points: tuple[Point, ...]
    path: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    summary: str
    width: int = WIDTH
    height: int = HEIGHT
    left: int = _LEFT
    top: int = _TOP
    right: int = WIDTH - _RIGHT
    bottom: int = HEIGHT - _BOTTOM


def make_chart(rows: Sequence[Row]) -> Chart | None:
    """Lay out the contenders that have both figures; None where fewer than two have."""
    both = [row for row in rows if row.afr is not None and row.relative_coverage is not None]
    if len(both) < 2:
        return None
    most = max(1.0, *(_end(row) for row in both))
    step = 0.2 if most <= 1.4 else 0.5

    def across(coverage: float) -> float:
        return round(_LEFT + (WIDTH - _LEFT - _RIGHT) * coverage / (most * 1.02), 1)

    def up(rate: float) -> float:
        return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * rate / 1.02, 1)

    places = {row.entry: (across(_x(row)), up(_y(row))) for row in both}
    front = sorted(_front(both), key=lambda row: places[row.entry])
    taken = [(x - 6, y - 6, x + 6, y + 6) for x, y in places.values()]
    points = []
    # those on the front choose the places of their labels first
    for row in sorted(both, key=lambda row: (row not in front, -_y(row))):
        x, y = places[row.entry]
        text_x, text_y, anchor = _place(x, y, row.label, taken)
        points.append(
            Point(
                row.label,
                row.entry,
                row.control,
                row in front,
                x,
                y,
                tuple(_bars(row, across, up)),
                text_x,
                text_y,
                anchor,
                f"{row.label}: AFR {100 * _y(row):.1f} %, coverage {100 * _x(row):.1f} % of ideal",
            )
        )
    names = ", ".join(row.label for row in front)
    return Chart(
        tuple(points),
        _steps([places[row.entry] for row in front]),
        tuple(_ticks(most, step, across)),
        tuple(_ticks(1.0, 0.2, up)),
        f"On the front, from the highest AFR to the highest coverage: {names}." if names else "",
    )


def _x(row: Row) -> float:
    assert row.relative_coverage is not None
    return row.relative_coverage.value


def _y(row: Row) -> float:
    assert row.afr is not None
    return row.afr.value


def _end(row: Row) -> float:
    assert row.relative_coverage is not None
    interval = row.relative_coverage.interval_95
    return interval[1] if interval else _x(row)


def _front(rows: Iterable[Row]) -> list[Row]:
    ranked = [row for row in rows if not row.control and row.complete]
    return [row for row in ranked if not any(_x(o) > _x(row) and _y(o) > _y(row) for o in ranked)]


def _bars(row: Row, across: Scale, up: Scale) -> Iterator[Box]:
    assert row.afr is not None
    assert row.relative_coverage is not None
    x, y = across(_x(row)), up(_y(row))
    if row.relative_coverage.interval_95:
        low, high = row.relative_coverage.interval_95
        yield across(max(low, 0.0)), y, across(high), y
    if row.afr.interval_95:
        low, high = row.afr.interval_95
        yield x, up(max(low, 0.0)), x, up(min(high, 1.0))


def _steps(places: Sequence[tuple[float, float]]) -> str:
    """Draw what the front dominates as steps; the places go from left to right."""
    if not places:
        return ""
    parts = [f"M{_LEFT} {places[0][1]} H{places[0][0]}"]
    parts += [f"V{y} H{x}" for x, y in places[1:]]
    return " ".join((*parts, f"V{HEIGHT - _BOTTOM}"))


def _ticks(end: float, step: float, to: Scale) -> Iterator[Tick]:
    for i in range(int(end / step + 1e-9) + 1):
        yield Tick(to(i * step), f"{100 * i * step:.0f}")


def _place(x: float, y: float, label: str, taken: list[Box]) -> tuple[float, float, str]:
    """Find a place for a label beside its point where nothing else is, and take it."""
    width = _LETTER * len(label)
    offsets = [(9, 4, "start"), (-9, 4, "end"), (0, -10, "middle"), (0, 20, "middle")]
    offsets += [
        (side * 8, up, "start" if side > 0 else "end")
        for up in (-9, 17, -20, 28)
        for side in (1, -1)
    ]
    for right, down, anchor in offsets:
        text_x, text_y = x + right, y + down
        left = text_x - {"start": 0.0, "middle": width / 2, "end": width}[anchor]
        box = (left, text_y - _LINE + 3, left + width, text_y + 3)
        inside = box[0] > _LEFT and box[2] < WIDTH and box[1] > 0 and box[3] < HEIGHT - _BOTTOM
        if inside and not any(_overlap(box, other) for other in taken):
            taken.append(box)
            return round(text_x, 1), round(text_y, 1), anchor
    return x, y, ""


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
