"""The undisturbed tracks, one for each number of anchor points, and how far mu moves an anchor.

Every template is a regular course of 96 m, flown anticlockwise. Its range is the widest, in steps
of half a metre, at which for every mu all frames of the track stay at least 0.9 m apart and 0.8 m
off the start, as far as a search for the worst mu can tell. No pilot was asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.parameters import Parameter, ParameterSpace

LEAST_SPACING_M = 0.9
"""Between any two frames of a track."""
LEAST_START_M = 0.8
"""Between the start and any frame."""


@dataclass(frozen=True)
class Template:
    """An undisturbed track.

    Attributes:
        anchors: The anchor points in m, in the order of flight.
        range_m: How far mu = 1 moves an anchor, along x and along y.
    """

    anchors: tuple[tuple[float, float], ...]
    range_m: float

    @property
    def parameters(self) -> ParameterSpace:
        """What mu controls: the anchors' displacements, x and y of the first one first."""
        return ParameterSpace(
            *(
                Parameter(f"anchor_{number}_{axis}_m", -self.range_m, self.range_m, "m")
                for number in range(1, len(self.anchors) + 1)
                for axis in "xy"
            )
        )

    def displaced(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """The anchors (n, k, 2) of a batch of mu (n, 2 k)."""
        moved = self.range_m * np.asarray(mu, np.float32).astype(np.float64)
        anchors: npt.NDArray[np.float64] = np.array(self.anchors) + moved.reshape(
            len(moved), len(self.anchors), 2
        )
        return anchors


TEMPLATES = {
    3: Template(((-23.2, -13.4), (23.2, -13.4), (0.0, 26.8)), 10.0),
    4: Template(((-16.1, -13.4), (16.1, -13.4), (16.1, 13.4), (-16.1, 13.4)), 8.0),
    5: Template(((-11.0, -15.1), (11.0, -15.1), (17.7, 5.8), (0.0, 18.7), (-17.7, 5.8)), 6.5),
}
"""By the number of anchor points."""


def template(anchors: int) -> Template:
    """The template with so many anchor points.

    Raises:
        ValueError: If there is none.
    """
    if isinstance(anchors, bool) or anchors not in TEMPLATES:
        raise ValueError(
            f"Expected anchors among {', '.join(map(str, TEMPLATES))}, got {anchors!r}."
        )
    return TEMPLATES[anchors]
