"""What the pixel kernels are given: a town as arrays."""

from __future__ import annotations

from typing import NamedTuple

from sada_gym.arrays import Bytes, Floats32
from sada_gym.envs.driving.camera.ground import TEXEL_M, Ground
from sada_gym.envs.driving.camera.scenery import Scenery

SHADE_LEVEL = 2
"""The level of the ground's mip map at whose resolution shadows are kept."""
SHADE_TEXEL_M = TEXEL_M * 2**SHADE_LEVEL


class TownArrays(NamedTuple):
    """A town for the kernels: clouds are periodic noise, tone maps light to bytes."""

    ground: Ground
    scenery: Scenery
    clouds: Floats32
    tone: Bytes
