"""Which semantic parameters the adversary of object detection sets, and what the others are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError, check_known
from sada_gym.parameters import Parameter, ParameterSpace

DEFAULT_PARAMETERS = "paper"
DEFAULT_PITCH_DEG = 0.0, 51.6
POLE_SHIFT = "pole_shift"
COLOUR = ("colour_red", "colour_green", "colour_blue")

_PAPER = ParameterSpace(
    Parameter("camera_distance", 8.0, 14.5, "scene units"),
    Parameter(
        *("camera_azimuth_deg", -180.0, 180.0, "deg"),
        directions=("in front", "on the left", "behind", "on the right"),
    ),
    Parameter("camera_pitch_deg", *DEFAULT_PITCH_DEG, "deg"),
    Parameter(
        *("light_azimuth_deg", -180.0, 180.0, "deg"),
        directions=(
            *("behind the camera", "right of the camera"),
            *("opposite the camera", "left of the camera"),
        ),
    ),
    Parameter("light_pitch_deg", 3.0, 90.0, "deg"),
    *(Parameter(name, 0.0, 1.0) for name in COLOUR),
)
_PITCH = "camera_pitch_deg"
_BLUE = dict(zip(COLOUR, (0.0, 0.0, 1.0), strict=True))
_GREY = dict.fromkeys(COLOUR, 0.5)
_MIDDLE = {"camera_distance": 11.25}
_FROM_THE_SIDE = {"light_azimuth_deg": 45.0, "light_pitch_deg": 45.0}


@dataclass(frozen=True, eq=False)
class ParameterSet:
    """The parameters of mu, and the physical values of those that are fixed."""

    parameters: ParameterSpace
    fixed: Mapping[str, float]

    def values(self, mu: npt.NDArray[np.float32]) -> dict[str, float]:
        """Name the physical values of one mu, (d,), and the fixed ones."""
        return {**self.parameters.describe(mu), **self.fixed}

    @property
    def pitch_range(self) -> tuple[float, float]:
        """The range of the camera's pitch, in degrees."""
        pitch = next(
            parameter for parameter in self.parameters.parameters if parameter.name == _PITCH
        )
        return pitch.low, pitch.high

    def with_pitch(self, low: float, high: float) -> ParameterSet:
        """Return the same set with another range of the camera's pitch."""
        space = (
            replace(parameter, low=low, high=high) if parameter.name == _PITCH else parameter
            for parameter in self.parameters.parameters
        )
        return ParameterSet(ParameterSpace(*space), self.fixed)


def _without(fixed: Mapping[str, float], *more: Parameter) -> ParameterSet:
    chosen = (parameter for parameter in _PAPER.parameters if parameter.name not in fixed)
    return ParameterSet(ParameterSpace(*chosen, *more), fixed)


PARAMETER_SETS = {
    "paper": _without({}),
    "viewpoint": _without({**_MIDDLE, **_BLUE}),
    "occlusion": _without(
        {**_MIDDLE, **_FROM_THE_SIDE, **_BLUE},
        Parameter(POLE_SHIFT, -1.0, 1.0, "half pictures"),
    ),
    "unpainted": _without(_GREY),
}
"""The paper's eight, those of its two case studies (appendix, "Diagnosis"), and the five without
paint."""


def find_parameters(name: str, camera_pitch_deg: Sequence[float] | None) -> ParameterSet:
    """Find a set by its name, with another range of the camera's pitch than the paper's if given.

    Raises:
        UserError: If there is no such set, or no such range.
    """
    check_known("parameters", [name], list(PARAMETER_SETS))
    chosen = PARAMETER_SETS[name]
    if camera_pitch_deg is None:
        return chosen
    low, high = _pitch_range(camera_pitch_deg)
    return chosen.with_pitch(low, high)


def _pitch_range(given: Any) -> tuple[float, float]:
    numbers = (
        isinstance(given, Sequence)
        and len(given) == 2
        and all(isinstance(end, int | float) and math.isfinite(end) for end in given)
    )
    if not numbers or not 0.0 <= given[0] < given[1] <= 90.0:
        raise UserError(
            "Expected camera_pitch_deg as a range within 0 to 90 degrees, such as [5, 45], got "
            f"{given!r}."
        )
    return float(given[0]), float(given[1])
