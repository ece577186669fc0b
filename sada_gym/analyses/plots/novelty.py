"""Pictures of novelty: samples beside the training queries nearest to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from sada_gym.analyses.plots.attack import contact_sheet
from sada_gym.errors import UserError
from sada_gym.foundations.frames import Frame
from sada_gym.measures.novelty import Neighbour, Neighbours

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def novelty_sheet(adversary: Sequence[Neighbours], ideal: Sequence[Neighbours] = ()) -> Figure:
    """Lay out samples, each beside its nearest training queries in mu and in image space.

    The paper's figure "Nearest Neighbor in Training". The captions give `Neighbour.mu_distance` and
    `Neighbour.pixel_distance`. Ideal samples, as many or none, stand on the right.

    Raises:
        ValueError: If there is no sample, or not as many of both.
    """
    if not adversary or (ideal and len(ideal) != len(adversary)):
        raise UserError(
            "Expected at least one sample of the adversary and as many ideal ones or none, got "
            f"{len(adversary)} and {len(ideal)}."
        )
    pictures = [
        picture
        for pair in zip_longest(adversary, ideal)
        for name, sample in zip(("adversary's sample", "ideal sample"), pair, strict=True)
        if sample is not None
        for picture in _captioned(name, sample)
    ]
    frames, captions = zip(*pictures, strict=True)
    title = "Samples and their nearest queries (distance in μ, in pixels)"
    return contact_sheet(frames, captions, title)


def _captioned(name: str, sample: Neighbours) -> Iterator[tuple[Frame, str]]:
    yield sample.frame, name
    yield sample.in_mu.frame, f"nearest in μ ({_distances(sample.in_mu)})"
    yield sample.in_image.frame, f"nearest image ({_distances(sample.in_image)})"


def _distances(neighbour: Neighbour) -> str:
    return f"{neighbour.mu_distance:.2f}, {neighbour.pixel_distance:.2f}"
