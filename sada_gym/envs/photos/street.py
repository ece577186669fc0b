"""Frames of a street with people: `vtest.avi`, which comes with OpenCV's examples.

They are of PETS 2009's data set S2.L1 (Ferryman and Shahrokni), made for measuring how people are
found and followed.
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

import numpy as np

from sada_gym.errors import FileError, MissingPart
from sada_gym.foundations.arrays import Bytes
from sada_gym.foundations.files import read_file

VARIABLE = "SADA_GYM_STREET"
"""Names the film where it lies elsewhere."""

FILM = Path("/usr/share/doc/opencv-doc/examples/data/vtest.avi")
"""Where Debian's package opencv-doc puts it."""

SHA256 = "45cddc9490be69345cbdab64ca583be65987e864ca408038e648db99e10516cf"
FRAMES = 40
_MAX_BYTES = 2**24


def film() -> Path:
    """Return the film's file, checked.

    Raises:
        MissingPart: If it is not there, or another one.
    """
    path = Path(os.environ.get(VARIABLE) or FILM)
    fix = (
        f"Install it by `sudo apt install opencv-doc`, or set {VARIABLE} to the vtest.avi of "
        "OpenCV's examples."
    )
    if not path.is_file():
        raise MissingPart(f"Expected the film {path}, got no such file. {fix}")
    got = hashlib.sha256(read_file(path, _MAX_BYTES)).hexdigest()
    if got != SHA256:
        raise MissingPart(f"Expected {path} with SHA-256 {SHA256[:12]}..., got {got[:12]}. {fix}")
    return path


def street() -> tuple[Bytes, ...]:
    """Return `FRAMES` frames, evenly over the film, (576, 768, 3) uint8 each.

    Raises:
        FileError: If the film is missing, or OpenCV cannot read it.
    """
    return _frames(film())


@cache
def _frames(path: Path) -> tuple[Bytes, ...]:
    import cv2

    opened = cv2.VideoCapture(str(path))
    count = int(opened.get(cv2.CAP_PROP_FRAME_COUNT))
    wanted = {*np.linspace(0, count - 2, FRAMES).astype(int).tolist()} if count > FRAMES else set()
    frames: list[Bytes] = []
    for number in range(count):
        is_read, frame = opened.read()
        if is_read and number in wanted:
            frames.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
    opened.release()
    if len(frames) != FRAMES:
        raise FileError(
            f"Expected {FRAMES} frames of {path}, got {len(frames)}: this OpenCV cannot read it. "
            "Install opencv-python-headless."
        )
    return tuple(frames)
