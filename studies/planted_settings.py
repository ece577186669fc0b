"""Settings with planted weaknesses of known shape, and the application that they fool."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym import Parameter, ParameterSpace
from sada_gym.application import Application, Scored
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.parameters import Mu

AROUND = ("in front", "on the left", "behind", "on the right")
DIMENSIONS = (2, 3, 4, 6, 8, 10)
KINDS = ("box", "band", "cyclic", "thin", "choice", "ellipse", "diagonal")
TESTED, THRESHOLD = 40_000, 0.5
_MOST_TOGETHER = 0.4


@dataclass(frozen=True)
class Planted:
    """A planted weakness: which shares of the ranges, (n, d), lie in it, and how often it fools."""

    kind: str
    contains: Callable[[Floats], Bools]
    rate: float
    volume: float


@dataclass(frozen=True)
class Setting:
    """A space with planted weaknesses, and the rate at which the agent is fooled elsewhere."""

    seed: int
    space: ParameterSpace
    planted: tuple[Planted, ...]
    elsewhere: float

    def rates(self, shares: Floats) -> Floats:
        """Return how often each world fools, (n,)."""
        found = np.full(len(shares), self.elsewhere)
        for weakness in self.planted:
            inside = weakness.contains(shares)
            found[inside] = np.maximum(found[inside], weakness.rate)
        return found


class PlantedApplication(Application):
    """Fools with the chances of a setting: a score of 0 or 1, fixed by mu and the seed."""

    name = "planted"
    fooling_threshold = THRESHOLD
    sample_size = 250

    def __init__(self, setting: Setting) -> None:
        self.setting, self.parameters = setting, setting.space

    @property
    def settings(self) -> dict[str, int]:
        return {"seed": self.setting.seed}

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        drawn = np.array([np.random.default_rng(seed).random() for seed in seeds])
        fooled = drawn < self.setting.rates((mu.astype(np.float64) + 1.0) / 2.0)
        return Scored(1.0 - fooled, [{} for _ in seeds])


def plant(seed: int) -> Setting:
    """Make the setting of a seed."""
    rng = np.random.default_rng([seed, 50])
    while True:
        space = _space(rng)
        wanted = 1 + int(rng.integers(4))
        shares = rng.random((TESTED, len(space)))
        planted: list[Planted] = []
        taken = np.zeros(TESTED, np.bool_)
        for _ in range(200):
            if len(planted) == wanted:
                break
            kind, contains = _shape(rng, space)
            inside = contains(shares)
            volume = float(inside.mean())
            if not 0.02 <= volume <= 0.25 or (taken & inside).sum() > 0.1 * inside.sum():
                continue
            if (taken | inside).mean() > _MOST_TOGETHER:
                continue
            taken |= inside
            planted.append(Planted(kind, contains, float(rng.uniform(0.6, 1.0)), volume))
        if len(planted) == wanted:
            return Setting(seed, space, tuple(planted), float(rng.uniform(0.0, 0.1)))


def _space(rng: np.random.Generator) -> ParameterSpace:
    parameters = []
    for i in range(int(rng.choice(DIMENSIONS))):
        kind = rng.choice(["plain", "plain", "plain", "around", "choice", "whole", "log"])
        if kind == "around":
            parameters.append(Parameter(f"p{i}_deg", -180.0, 180.0, "deg", directions=AROUND))
        elif kind == "choice":
            count = int(rng.integers(3, 7))
            names = tuple("abcdef"[:count])
            parameters.append(Parameter(f"p{i}", 0.0, float(count), choices=names))
        elif kind == "whole":
            parameters.append(Parameter(f"p{i}", 0.5, 0.5 + int(rng.integers(4, 13)), whole=True))
        elif kind == "log":
            parameters.append(Parameter(f"p{i}", 0.01, 10.0, log=True))
        else:
            low = float(rng.choice([0.0, -1.0, 5.0]))
            high = low + float(rng.choice([1.0, 7.3, 60.0]))
            parameters.append(Parameter(f"p{i}_m", low, high, "m"))
    return ParameterSpace(*parameters)


def _is_plain(parameter: Parameter) -> bool:
    return not (parameter.choices or parameter.whole or parameter.directions)


def _shape(
    rng: np.random.Generator, space: ParameterSpace
) -> tuple[str, Callable[[Floats], Bools]]:
    d = len(space)
    kind = str(rng.choice(KINDS))
    plain = [i for i, p in enumerate(space.parameters) if _is_plain(p)]
    around = [i for i, p in enumerate(space.parameters) if p.directions]
    choices = [i for i, p in enumerate(space.parameters) if p.choices]
    linear = [i for i in plain if not space.parameters[i].log]
    if kind == "ellipse" and len(plain) >= 2:
        return kind, _ellipse(rng, *rng.choice(plain, 2, replace=False).tolist())
    if kind == "diagonal" and len(linear) >= 2:
        return kind, _diagonal(rng, *rng.choice(linear, 2, replace=False).tolist())
    if kind == "band":
        i = int(rng.integers(d))
        return kind, _all([_range(rng, space, i, rng.uniform(0.06, 0.25))])
    if kind == "cyclic" and around:
        i = int(rng.choice(around))
        rest = [j for j in range(d) if j != i]
        parts = [_range(rng, space, i, rng.uniform(0.1, 0.35))]
        if rng.random() < 0.5:
            parts.append(_range(rng, space, int(rng.choice(rest)), rng.uniform(0.3, 0.6)))
        return kind, _all(parts)
    if kind == "thin" and plain:
        i = int(rng.choice(plain))
        return kind, _all([_range(rng, space, i, rng.uniform(0.025, 0.05))])
    if kind == "choice" and choices:
        i = int(rng.choice(choices))
        rest = [j for j in range(d) if j != i]
        parts = [_range(rng, space, i, rng.uniform(0.2, 0.5))]
        parts.append(_range(rng, space, int(rng.choice(rest)), rng.uniform(0.2, 0.6)))
        return kind, _all(parts)
    count = int(rng.integers(2, min(d, 3) + 1))
    volume = rng.uniform(0.02, 0.12)
    cuts = rng.dirichlet(np.full(count, 6.0))
    members = rng.choice(d, count, replace=False)
    return "box", _all(
        [_range(rng, space, int(i), volume**cut) for i, cut in zip(members, cuts, strict=True)]
    )


def _all(parts: Sequence[Callable[[Floats], Bools]]) -> Callable[[Floats], Bools]:
    return lambda shares: np.logical_and.reduce([part(shares) for part in parts])


def _range(
    rng: np.random.Generator, space: ParameterSpace, i: int, width: float
) -> Callable[[Floats], Bools]:
    parameter = space.parameters[i]
    if parameter.choices:
        count = len(parameter.choices)
        taken = rng.choice(count, max(1, round(width * count)), replace=False)
        return lambda s: np.isin(np.minimum((s[:, i] * count).astype(int), count - 1), taken)
    if parameter.directions:
        start = rng.random()
        return lambda s: (s[:, i] - start) % 1.0 < width
    if parameter.whole:
        count = round(parameter.high - parameter.low)
        size = max(1, round(width * count))
        first = int(rng.integers(count - size + 1))
        return lambda s: (s[:, i] >= first / count) & (s[:, i] < (first + size) / count)
    # a third of them begin or end with the range
    place = rng.choice([0.0, 1.0, rng.random(), rng.random()])
    low = place * (1.0 - width)
    return lambda s: (s[:, i] >= low) & (s[:, i] <= low + width)


def _ellipse(rng: np.random.Generator, a: int, b: int) -> Callable[[Floats], Bools]:
    area, aspect, angle = rng.uniform(0.03, 0.15), rng.uniform(1.0, 2.5), rng.uniform(0, np.pi)
    half = np.sqrt(area / np.pi * np.array([aspect, 1.0 / aspect]))
    centre = rng.uniform(0.2, 0.8, 2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def contains(shares: Floats) -> Bools:
        place = (shares[:, [a, b]] - centre) @ turn.T / half
        return (place**2).sum(axis=1) <= 1.0

    return contains


def _diagonal(rng: np.random.Generator, a: int, b: int) -> Callable[[Floats], Bools]:
    slope = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    centre, width = rng.uniform(-0.6, 0.6), rng.uniform(0.05, 0.25)

    def contains(shares: Floats) -> Bools:
        across = (shares[:, a] - 0.5) + slope * (shares[:, b] - 0.5)
        return np.abs(across - centre) <= width / 2.0

    return contains
