"""The gates: frames of four bars, all of one size, standing upright on flat ground.

A gate is x, y and z of its opening's centre and the heading in which it has to be passed. In the
gate's own frame x points in that direction, y to the left and z up.
"""

from __future__ import annotations

import numpy as np

from sada_gym.foundations.arrays import Floats

OPENING_WIDTH_M = 2.4
OPENING_HEIGHT_M = 2.4
BAR_M = 0.3
"""A bar's width, seen from the front."""
DEPTH_M = 0.3
"""A bar's depth, along the direction of flight."""
CENTRE_HEIGHT_M = 2.0
"""The height of the opening's centre above the ground, which is z = 0."""

OUTER_WIDTH_M = OPENING_WIDTH_M + 2 * BAR_M
TOP_M = CENTRE_HEIGHT_M + OPENING_HEIGHT_M / 2 + BAR_M
"""The frame's height above the ground."""

_SIDE = (OPENING_WIDTH_M + BAR_M) / 2
_RISE = (OPENING_HEIGHT_M + BAR_M) / 2

BARS: Floats = np.array(
    [
        [_SIDE, TOP_M / 2 - CENTRE_HEIGHT_M, BAR_M / 2, TOP_M / 2],
        [-_SIDE, TOP_M / 2 - CENTRE_HEIGHT_M, BAR_M / 2, TOP_M / 2],
        [0.0, _RISE, OPENING_WIDTH_M / 2, BAR_M / 2],
        [0.0, -_RISE, OPENING_WIDTH_M / 2, BAR_M / 2],
    ]
)
"""The four boxes of a gate, (4, 4): y and z of the middle from the opening's centre, half the
width and half the height. The first two are posts from the ground to the top. Each is `DEPTH_M`
deep, its middle in the gate's plane. What is drawn and what is solid are these."""
