"""Values that change over an episode: curves through a few parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

Curve = Literal["linear", "cubic", "steps"]
"""Straight lines between the knots, a smooth curve, or a constant value from knot to knot."""

MOST_KNOTS = 10_000


@dataclass(frozen=True)
class Profile:
    """A value over the steps of an episode, `profile(step)`, through values at its knots.

    The first knot lies at step 0, the last one at the last step, and the others evenly between;
    with "steps" each value holds for an equal part of them. A cubic curve goes up and down only
    where its knots do (Fritsch and Carlson 1980), so that it never leaves the parameters' range.

    Attributes:
        values: At the knots.
        over: The number of steps; later ones have the last value.
        curve: How it goes from knot to knot.
        whole: Whether the values between are rounded to whole numbers.
    """

    values: tuple[Any, ...]
    over: int
    curve: Curve = "linear"
    whole: bool = False

    def __call__(self, step: int) -> Any:
        """Return the value at a step of the environment, from 0."""
        return self._table[min(step, self.over - 1)]

    def __repr__(self) -> str:
        """Show the values at the knots."""
        return f"({', '.join(map(repr, self.values))})"

    @cached_property
    def _table(self) -> list[Any]:
        steps, count = np.arange(self.over), len(self.values)
        if self.curve == "steps":
            return [self.values[i] for i in (steps * count // self.over).tolist()]
        knots = np.linspace(0.0, self.over - 1, count)
        if self.curve == "linear" or self.over < count:
            between = np.interp(steps, knots, self.values)
        else:
            from scipy.interpolate import PchipInterpolator

            between = PchipInterpolator(knots, self.values)(steps)
            between = np.clip(between, min(self.values), max(self.values))  # but for rounding
        rounded: list[Any] = np.floor(between + 0.5).astype(int).tolist()
        return rounded if self.whole else between.tolist()


@dataclass(frozen=True, eq=False)
class Live(Profile):
    """A value that somebody chooses while the episode goes on; copies share it.

    `values` holds the greatest one that may be chosen.
    """

    chosen: list[Any] = field(default_factory=list)

    def __call__(self, step: int) -> Any:  # noqa: ARG002
        """Return what was chosen last."""
        return self.chosen[-1]

    def __deepcopy__(self, memo: dict[int, Any]) -> Live:
        """Return the same."""
        return self


def now(value: Any, step: int) -> Any:
    """Return a value at a step, whether it changes or not."""
    return value(step) if isinstance(value, Profile) else value
