"""MP4 needs an optional package."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from sada_gym.analyses.replay.mp4 import FPS, _at_one_rate, mp4
from sada_gym.errors import MissingExtra


def test_without_the_package_the_message_names_the_line_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtra, match=r"pip install -c constraints.txt '\.\[video\]'"):
        mp4([np.zeros((4, 4, 3), np.uint8)], [1.0])


def test_frames_stand_for_their_time():
    frames = [np.full((2, 2, 3), i, np.uint8) for i in range(3)]
    shown = [int(frame[0, 0, 0]) for frame in _at_one_rate(frames, [0.1, 0.06, 1.5])]
    assert shown.count(2) == 1.5 * FPS
    assert len(shown) == round(1.66 * FPS)


def test_a_video_of_odd_size_is_written():
    pytest.importorskip("imageio_ffmpeg")
    content = mp4([np.full((33, 47, 3), i, np.uint8) for i in range(0, 250, 25)], [0.1] * 10)
    assert content[4:8] == b"ftyp"
    assert len(content) > 500
