"""SADA-Analytic: an instant application whose fooling set is known exactly, in any dimension."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application, Scored, validate_world
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats, Integers
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.frames import Frame, LegendEntry
from sada_gym.parameters import Mu, Parameter, ParameterSpace

_AT_ONCE = 2**24
"""Numbers held in memory while distances are computed."""

_GOLDEN = (5**0.5 - 1) / 2
_IMAGE_SIZE = 128
_MAXIMUM = 1_000  # dimensions and regions: adversaries take no more
_FOOLED_RGB, _THRESHOLD_RGB, _UNHURT_RGB = (178, 24, 43), (247, 247, 247), (33, 102, 172)


class AnalyticApplication(Application):
    """An instant application whose fooling set is known exactly.

    ## Description
    There is no agent: the score is a function of mu, the point, alone. It grows with the distance
    to the nearest of `regions` separate boxes in [-1, 1]^d. These boxes are the fooling set; they
    fill the share `volume` of the space in any dimension, so that share of uniform points fools.

    [-1, 1]^d is cut into as many equal cells as there are regions, and each cell holds one box that
    fills the share `volume` of it. So the boxes never touch, and every dimension bounds every box.
    Their places in their cells follow a golden-ratio sequence: there is no symmetry to exploit, and
    nothing is random.

    ## Action Space
    `Box(-1, 1, (dimension,), float32)`: the point, without a unit.

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | i | `x{i}` | -1 | 1 | none |

    ## Observation Space
    `Box(-1, 1, (dimension + 2,), float32)`: last mu, last score, share of the steps left; zeros
    where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`. The score is Q = t m^2 / (t m^2 + 1 - t) with t = 0.3
    the fooling threshold and m the distance to the nearest box's centre in the maximum norm, in
    units of the box's half sides: 0 at a centre, t on the surface, below 1 everywhere.

    ## Starting State
    No proposal yet. The seed matters only with `noise`.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.3), `seed`, `parameters` and `region`, the region that mu lies in, or -1.
    With `noise` the region is that of the undisturbed score.

    ## Arguments
    - `dimension=2`: number of parameters, at most 1,000.
    - `regions=4`: number of separate fooling regions, at most 1,000.
    - `volume=0.1`: the fooling set's share of the whole space, in (0, 1).
    - `noise=0.0`: half width of a uniform disturbance of the score, fixed by the seed, in [0, 1).
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`. A frame shows the score over the first
      two parameters, and mu as a cross.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Analytic"
    fooling_threshold = 0.3
    sample_size = 250

    def __init__(
        self, *, dimension: int = 2, regions: int = 4, volume: float = 0.1, noise: float = 0.0
    ) -> None:
        for what, count in (("dimension", dimension), ("regions", regions)):
            if isinstance(count, bool) or not isinstance(count, int) or count < 1:
                raise UserError(f"Expected {what} to be an int of at least 1, got {count!r}.")
            if count > _MAXIMUM:
                raise UserError(f"Expected {what} of at most {_MAXIMUM:,}, got {count:,}.")
        for what, share in (("volume", volume), ("noise", noise)):
            if not isinstance(share, int | float):
                raise UserTypeError(f"Expected {what} to be a number, got {share!r}.")
        if not 0.0 < volume < 1.0:
            raise UserError(f"Expected volume to be a share within (0, 1), got {volume}.")
        if not 0.0 <= noise < 1.0:
            raise UserError(f"Expected noise to be within [0, 1), got {noise}.")
        self.regions, self.volume, self.noise = regions, volume, noise
        self.parameters = ParameterSpace(*(Parameter(f"x{i}", -1.0, 1.0) for i in range(dimension)))
        self.centres, self.half_sides = _place_boxes(dimension, regions, volume)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords."""
        return {
            "dimension": len(self.parameters),
            "regions": self.regions,
            "volume": self.volume,
            "noise": self.noise,
        }

    def fooling_region(self, mu: npt.ArrayLike) -> Integers:
        """Return the region of each mu (n, d): (n,) indices, -1 where Q is above the threshold."""
        return self._regions(self.parameters.validate(mu))[0]

    def sample_fooling_set(self, n: int, rng: np.random.Generator) -> Mu:
        """Draw n mu uniformly from the true fooling set: (n, d) float32."""
        region = rng.integers(self.regions, size=n)
        offset = rng.uniform(-1.0, 1.0, size=(n, len(self.parameters)))
        # rounding to float32 must not leave the box
        inside = np.maximum(self.half_sides - 1e-6, 0.0)
        return (self.centres[region] + offset * inside).astype(np.float32)

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say which region mu lies in."""
        place = f"in region {info['region']}" if info["region"] >= 0 else "outside the regions"
        return Behaviour(place, (place,) if info["fooled"] else ())

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the colours and lines in frames mean."""
        blue, red = ("#{:02x}{:02x}{:02x}".format(*c) for c in (_UNHURT_RGB, _FOOLED_RGB))
        return (
            LegendEntry(f"fooled: Q ≤ {self.fooling_threshold:g}", red, "area"),
            LegendEntry("not fooled", blue, "area"),
            LegendEntry("border of the fooling set", "#000000", "line"),
            LegendEntry("the sample", "#000000", "plus"),
            LegendEntry("Across: x0. Up: x1. The other coordinates are the sample's."),
        )

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw `observation`, and a line around where Q fools."""
        frame, score = self._drawn(mu, seed)
        fooled = fools(score, self.fooling_threshold)
        inside = fooled.copy()
        for axis in (0, 1):
            for step in (1, -1):
                inside &= np.roll(fooled, step, axis)
        frame[fooled & ~inside] = 0
        return frame

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw Q over the first two coordinates, the others held at mu, and a cross at mu."""
        return self._drawn(mu, seed)[0]

    def _drawn(self, mu: npt.ArrayLike, seed: int) -> tuple[Frame, Floats]:
        """Draw `observation`, and return the scores in it, too, (rows, columns)."""
        (point,), seed = validate_world(self.parameters, mu, seed)
        axis = np.linspace(-1.0, 1.0, _IMAGE_SIZE, dtype=np.float32)
        grid = np.tile(point, (_IMAGE_SIZE * _IMAGE_SIZE, 1))
        grid[:, 0] = np.tile(axis, _IMAGE_SIZE)
        if len(point) > 1:
            grid[:, 1] = np.repeat(axis[::-1], _IMAGE_SIZE)
        score = self.evaluate_batch(grid, [seed] * len(grid)).score
        score = score.reshape(_IMAGE_SIZE, _IMAGE_SIZE)
        stops = (0.0, self.fooling_threshold, 1.0)
        channels = zip(_FOOLED_RGB, _THRESHOLD_RGB, _UNHURT_RGB, strict=True)
        frame = np.stack([np.interp(score, stops, c) for c in channels], axis=-1).astype(np.uint8)
        column = round(float(point[0] + 1) / 2 * (_IMAGE_SIZE - 1))
        height = float(point[1]) if len(point) > 1 else 0.0
        row = round((1 - height) / 2 * (_IMAGE_SIZE - 1))
        frame[row, max(column - 5, 0) : column + 6] = 0
        frame[max(row - 5, 0) : row + 6, column] = 0
        return frame, score

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        region, score = self._regions(mu)
        if self.noise:
            shift = {seed: np.random.default_rng(seed).uniform(-1.0, 1.0) for seed in set(seeds)}
            score = np.clip(score + self.noise * np.array([shift[seed] for seed in seeds]), 0, 1)
        return Scored(score, [{"region": index} for index in region.tolist()])

    def _regions(self, mu: Mu) -> tuple[Integers, Floats]:
        """Return the region and the undisturbed Q of each mu, both (n,)."""
        rows = max(1, _AT_ONCE // self.centres.size)
        distance = np.empty((len(mu), self.regions))
        for start in range(0, len(mu), rows):
            offset = mu[start : start + rows].astype(np.float64)[:, None, :] - self.centres
            distance[start : start + rows] = np.abs(offset / self.half_sides).max(axis=2)
        weighted = self.fooling_threshold * distance.min(axis=1) ** 2
        score = weighted / (weighted + (1.0 - self.fooling_threshold))
        fooled = fools(score, self.fooling_threshold)
        return np.where(fooled, distance.argmin(axis=1), -1), score


def _place_boxes(dimension: int, regions: int, volume: float) -> tuple[Floats, Floats]:
    """Return the boxes' centres (regions, d) and their common half sides (d,)."""
    factors = _prime_factors(regions)
    cells_along = np.ones(dimension, dtype=np.int64)
    for i, factor in enumerate(factors):
        cells_along[i % dimension] *= factor
    split = min(dimension, max(len(factors), 1))
    cell = np.zeros((regions, dimension))
    cell[:, :split] = np.stack(np.unravel_index(np.arange(regions), cells_along[:split]), axis=1)
    width = 2.0 / cells_along
    half_sides = volume ** (1.0 / dimension) * width / 2.0
    golden = (_GOLDEN * np.arange(1, regions * dimension + 1)) % 1.0
    # four fifths of the free room, so that a gap always remains between neighbours
    shift = 0.8 * (width / 2.0 - half_sides) * (2.0 * golden.reshape(regions, dimension) - 1.0)
    return -1.0 + (cell + 0.5) * width + shift, half_sides


def _prime_factors(number: int) -> list[int]:
    factors, divisor = [], 2
    while number > 1:
        while number % divisor == 0:
            factors.append(divisor)
            number //= divisor
        divisor += 1
    return factors[::-1]
