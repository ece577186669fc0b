"""The roundest number of an interval."""

from __future__ import annotations

import math
from collections.abc import Iterator

_DIGITS = (5.0, 2.0, 1.0)
_ANGLES = (90.0, 45.0, 30.0, 15.0, 10.0, 5.0, 2.0, 1.0)


def roundest(low: float, high: float, near: float, *, angle: bool = False) -> float:
    """Return the roundest number from low to high; of equally round ones the one nearest `near`."""
    for step in _steps(high - low, angle=angle):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if first <= last:
            nearest = min(max(round(near / step), first), last)
            return float(f"{nearest * step:.12g}")
    return near


def _steps(width: float, *, angle: bool) -> Iterator[float]:
    if angle:
        yield from _ANGLES
    power = math.ceil(math.log10(max(width, 1e-300))) + 1
    for exponent in range(power, power - 6, -1):
        for digit in _DIGITS:
            if not angle or digit * 10.0**exponent < 1.0:
                yield digit * 10.0**exponent
