"""The same worlds in another parameter space: physical values stay, mu changes."""

from __future__ import annotations

import numpy as np

from sada_gym.errors import UserError
from sada_gym.parameters import Mu, ParameterSpace


def map_samples(
    mu: Mu, here: ParameterSpace, there: ParameterSpace, source: str, place: str
) -> tuple[Mu, dict[str, int]]:
    """Express samples, (n, d), by another space's mu: the physical values stay.

    Returns:
        The mu there, and how many samples of each parameter were moved to the end of its range.

    Raises:
        UserError: If the parameters of `place` differ from those of the run in `source` in names,
            units or choices.
    """
    missing = sorted({*there.names} - {*here.names})
    extra = sorted({*here.names} - {*there.names})
    if missing or extra:
        parts = [
            f"{word} {', '.join(names)}"
            for word, names in (("lacks", extra), ("has besides", missing))
            if names
        ]
        raise UserError(
            f"Expected the parameters of the run in {source}, got those of {place}, which "
            f"{' and '.join(parts)}. Choose a track with the same parameters, or attack that one."
        )
    known = {parameter.name: i for i, parameter in enumerate(here.parameters)}
    columns = [known[name] for name in there.names]
    moved, clipped = mu[:, columns].copy(), {}
    physical = here.physical(mu)[:, columns]
    normalised = there.normalised(physical)
    for i, new in enumerate(there.parameters):
        old = here.parameters[columns[i]]
        if (old.unit, old.choices) != (new.unit, new.choices):
            raise UserError(
                f"Expected {new.name} of {place} in the unit and with the choices of the run in "
                f"{source}, {(old.unit, *old.choices)}, got {(new.unit, *new.choices)}. Choose "
                "another track."
            )
        if (old.low, old.high, old.log) == (new.low, new.high, new.log):
            continue  # to the bit
        outside = int((np.abs(normalised[:, i]) > 1.0).sum())
        moved[:, i] = np.clip(normalised[:, i], -1.0, 1.0)
        if outside:
            clipped[new.name] = outside
    return moved, clipped
