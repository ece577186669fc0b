"""The undisturbed tracks, one for each number of anchor points, and how far mu moves an anchor.

Every template is a regular course of 80 m, flown anticlockwise. Where anchors come to lie so that
two frames would touch or nearly so, they are drawn back towards the template, all by one share,
until they do not: every mu gives a track that can be built. The range is the widest, in steps of
half a metre, at which no more than a twentieth of uniform mu are drawn back. No pilot was asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.envs.uav.world.track import Tracks
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools
from sada_gym.parameters import Parameter, ParameterSpace

LEAST_SPACING_M = 0.9
"""The least distance between any two frames of a track."""
LEAST_START_M = 0.8
"""The least distance between the start and any frame."""

_SHARES = np.linspace(0.95, 0.0, 20)


@dataclass(frozen=True)
class Template:
    """An undisturbed track."""

    anchors: tuple[tuple[float, float], ...]  # the anchor points in m, in the order of flight
    range_m: float  # the distance by which mu = 1 moves an anchor, along x and along y

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

    def tracks(self, mu: npt.ArrayLike) -> Tracks:
        """Lay the tracks of a batch of mu (n, 2 k); those that cannot be built are drawn back."""
        rows = np.asarray(mu, np.float32).astype(np.float64)
        moves = self.range_m * rows.reshape(len(rows), len(self.anchors), 2)
        home = np.array(self.anchors)
        tracks = Tracks(home + moves)
        for i in np.flatnonzero(~buildable(tracks)).tolist():
            for share in _SHARES.tolist():
                drawn_back = Tracks((home + share * moves[i])[None])
                if buildable(drawn_back)[0]:
                    tracks.replace(i, drawn_back, kept=share)
                    break
        return tracks


def buildable(tracks: Tracks) -> Bools:
    """Say whether all frames of tracks keep apart from one another and from the start, (n,)."""
    apart: Bools = tracks.closest_m() >= LEAST_SPACING_M
    apart &= tracks.start_m() >= LEAST_START_M
    return apart


TEMPLATES = {
    3: Template(((-19.3, -11.2), (19.3, -11.2), (0.0, 22.3)), 18.5),
    4: Template(((-13.4, -11.2), (13.4, -11.2), (13.4, 11.2), (-13.4, 11.2)), 15.0),
    5: Template(((-9.2, -12.6), (9.2, -12.6), (14.8, 4.8), (0.0, 15.6), (-14.8, 4.8)), 13.0),
}
"""The templates by the number of anchor points."""


def template(anchors: int) -> Template:
    """Return the template with this number of anchor points; raise `UserError` if none has it."""
    whole = isinstance(anchors, int | np.integer) and not isinstance(anchors, bool)
    if not whole or anchors not in TEMPLATES:
        raise UserError(
            f"Expected anchors among {', '.join(map(str, TEMPLATES))}, got {anchors!r}."
        )
    return TEMPLATES[anchors]
