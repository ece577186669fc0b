"""Two towns as they are planned: where streets meet, and which corners a street joins.

Both are our own. The drivers learn in `TRAINING`; the benchmark's routes lie in `BENCHMARK`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

Corner = str


@dataclass(frozen=True)
class Layout:
    """The plan of a town."""

    name: str
    # the places where streets meet, (x, y) in m by name; y points to the right of x
    corners: Mapping[Corner, tuple[float, float]]
    streets: tuple[tuple[Corner, Corner], ...]  # pairs of corners that a two-way street joins

    def neighbours(self, corner: Corner) -> tuple[Corner, ...]:
        """Return the corners that a street joins to this one."""
        return tuple(b if a == corner else a for a, b in self.streets if corner in (a, b))


def _grid(name: str, rows: tuple[str, ...], absent: str, **corners: tuple[float, float]) -> Layout:
    columns = zip(*(row.split() for row in rows), strict=True)
    lines = [*(row.split() for row in rows), *columns]
    pairs = [(a, b) for line in lines for a, b in pairwise(line)]
    without = {tuple(pair.split("-")) for pair in absent.split()}
    streets = tuple(pair for pair in pairs if pair not in without)
    return Layout(name, MappingProxyType(corners), streets)


BENCHMARK = _grid(
    "benchmark",
    ("A0 B0 C0 D0 E0", "A1 B1 C1 D1 E1", "A2 B2 C2 D2 E2", "A3 B3 C3 D3 E3"),
    absent="C1-D1 B2-B3 D2-E2",
    A0=(0, 0), B0=(82, -6), C0=(166, 5), D0=(248, 0), E0=(334, 8),
    A1=(-5, 78), B1=(86, 71), C1=(160, 83), D1=(252, 75), E1=(328, 82),
    A2=(6, 158), B2=(78, 163), C2=(170, 155), D2=(244, 166), E2=(338, 156),
    A3=(0, 240), B3=(88, 233), C3=(162, 242), D3=(254, 235), E3=(330, 244),
)  # fmt: skip

TRAINING = _grid(
    "training",
    ("A0 B0 C0 D0 E0", "A1 B1 C1 D1 E1", "A2 B2 C2 D2 E2", "A3 B3 C3 D3 E3", "A4 B4 C4 D4 E4"),
    absent="B0-C0 A2-B2 C1-C2 D2-D3 D3-E3 B3-B4 D0-D1",
    A0=(0, 0), B0=(70, 8), C0=(150, -6), D0=(242, 2), E0=(312, -4),
    A1=(-6, 66), B1=(78, 74), C1=(164, 64), D1=(234, 78), E1=(322, 70),
    A2=(8, 152), B2=(72, 140), C2=(156, 156), D2=(248, 146), E2=(316, 158),
    A3=(-4, 222), B3=(84, 230), C3=(150, 220), D3=(238, 234), E3=(326, 224),
    A4=(2, 310), B4=(74, 300), C4=(166, 314), D4=(244, 302), E4=(318, 312),
)  # fmt: skip

LAYOUTS = {layout.name: layout for layout in (BENCHMARK, TRAINING)}
