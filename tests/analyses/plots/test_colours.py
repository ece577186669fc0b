"""What must be told apart in pictures stays distinguishable to the colour-blind."""

import numpy as np
import pytest

from sada_gym.analyses.plots import style
from sada_gym.envs.detection import frame as detection
from sada_gym.envs.digits import base as digits
from sada_gym.envs.driving import frame as driving
from sada_gym.envs.robot import frame as robot
from sada_gym.envs.uav import frame as racing
from sada_gym.foundations import frames
from sada_gym.foundations.frames import rgb

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
MATRICES = {
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
}
TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
) / np.array([[0.9505], [1.0], [1.089]])

PAIRS = {
    "fooled, not": (style.FOOLED, style.UNHURT),
    "queries, samples": (style.OMEGA, frames.BLUE),
    "query that fooled, sample": (frames.ORANGE, frames.BLUE),
    "target, other": (detection._TARGET, detection._OTHER),
    "target, truth": (detection._TARGET, detection._TRUTH),
    "other, truth": (detection._OTHER, detection._TRUTH),
    "right, wrong": (digits.RIGHT, digits.WRONG),
    "gates": (racing._PASSED, racing._MISSED),
    "gate missed, way": (racing._MISSED, racing._FLOWN),
    "route, driven": (driving._ROUTE, driving._DRIVEN),
    "route, failed": (driving._DRIVEN, driving._FAILED),
    "planned, driven": (robot._WAY, robot._DRIVEN),
}


def seen(colour, matrix):
    """Return the CIE L*a*b* of a colour as seen through a matrix."""
    share = np.array(rgb(colour) if isinstance(colour, str) else colour) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(np.array(matrix) @ linear, 0, 1)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(first, other, matrix):
    return np.linalg.norm(seen(first, matrix) - seen(other, matrix))


@pytest.mark.parametrize("matrix", MATRICES.values(), ids=MATRICES)
@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_pairs_stay_apart(pair, matrix):
    assert difference(*pair, matrix) > 25


def test_red_and_green_would_not():
    assert difference((178, 24, 43), (20, 110, 50), MATRICES["deuteranopia"]) < 25


@pytest.mark.parametrize(
    "entries", [detection.legend("car"), digits.LEGEND, driving.LEGEND, racing.LEGEND, robot.LEGEND]
)
def test_entries_that_look_alike_in_grey_have_marks_of_their_own(entries):
    marks = [(entry.mark, entry.colour) for entry in entries if entry.mark != "note"]
    for i, (mark, colour) in enumerate(marks):
        for other, its in marks[:i]:
            alike = difference(colour, its, MATRICES["deuteranopia"]) < 25
            assert mark != other or not alike, f"{mark} in {colour} and {its}"
