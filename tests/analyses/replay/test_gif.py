"""GIFs: true colours, few bytes, right times."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image, ImageSequence

from sada_gym.analyses.replay.gif import COLOURS, Palette, _thinned, durations_ms, gif


def moving(count: int = 12, side: int = 64) -> list[np.ndarray]:
    """A grey ramp with noise and a small red square that moves over it."""
    ramp = np.broadcast_to(np.linspace(40, 200, side)[None, :, None], (side, side, 3))
    noise = np.random.default_rng(0).normal(0, 8, (side, side, 1))
    ground = (ramp + noise).clip(0, 255).astype(np.uint8)
    frames = []
    for i in range(count):
        frame = ground.copy()
        frame[10:14, 3 * i : 3 * i + 4] = (220, 20, 30)
        frames.append(frame)
    return frames


def decoded(content: bytes) -> tuple[list[np.ndarray], list[int], Image.Image]:
    video = Image.open(io.BytesIO(content))
    frames, times = [], []
    for frame in ImageSequence.Iterator(video):
        times.append(frame.info["duration"])
        frames.append(np.asarray(frame.convert("RGB")))
    return frames, times, video


def test_a_gif_keeps_colours_times_and_loops():
    frames = moving()
    pictures, times, video = decoded(gif(frames, [0.1] * 11 + [1.5], 10**6))
    assert len(pictures) == 12
    assert times == [100] * 11 + [1500]
    assert video.info["loop"] == 0
    for before, after in zip(frames, pictures, strict=True):
        off = np.abs(before.astype(int) - after)
        assert off.mean() < 2.5
        assert off.max() <= 24
    square = pictures[5][11, 16]
    assert np.abs(square.astype(int) - (220, 20, 30)).max() <= 8


def test_what_does_not_change_costs_nothing():
    frames = moving()
    still = gif(frames[:1], [1.0], 10**6)
    assert len(gif(frames, [0.1] * 12, 10**6)) < 2 * len(still)


def test_equal_frames_become_one_longer_frame():
    pictures, times, _ = decoded(gif([moving()[0]] * 5, [0.1] * 5, 10**6))
    assert (len(pictures), times) == (1, [500])


@pytest.mark.long
def test_a_small_limit_makes_it_smaller_and_keeps_the_ending():
    frames = [np.random.default_rng(i).integers(0, 256, (90, 120, 3), np.uint8) for i in range(20)]
    large = len(gif(frames, [0.1] * 19 + [1.5], 10**9))
    content = gif(frames, [0.1] * 19 + [1.5], large // 5)
    assert len(content) <= large // 5
    _, times, _ = decoded(content)
    assert times[-1] == 1500
    assert sum(times) == 3400


def test_what_cannot_be_made_small_enough_is_as_small_as_it_gets():
    frames = moving(4)
    assert 0 < len(gif(frames, [0.1] * 4, 1)) < len(gif(frames, [0.1] * 4, 10**6))


def test_thinning_keeps_the_last_frame_and_the_time():
    frames = moving(9)
    videos = [*_thinned(frames, [0.05] * 8 + [1.5])]
    for kept, times in videos:
        assert sum(times) == pytest.approx(1.9)
        assert kept[-1] is frames[-1]
        assert times[-1] == 1.5
    assert [len(kept) for kept, _ in videos] == [9, 5, 4]


def test_times_are_rounded_without_drift():
    times = durations_ms([1 / 16] * 160)
    assert sum(times) == 10_000
    assert set(times) == {60, 70}
    assert durations_ms([0.001]) == [20]  # browsers show a shorter one ten times longer


def test_a_rare_colour_keeps_its_place_in_the_palette():
    frame = np.zeros((200, 200, 3), np.uint8)
    frame[...] = np.random.default_rng(0).integers(90, 170, (200, 200, 3))
    frame[:3, :3] = (0, 98, 155)
    palette = Palette([frame], COLOURS)
    shown = palette.colours[palette.indices(frame)[1, 1]]
    assert np.abs(shown.astype(int) - (0, 98, 155)).max() <= 6


def test_few_colours_stay_as_they_are():
    frame = np.zeros((4, 4, 3), np.uint8)
    frame[0], frame[1] = (255, 255, 255), (194, 65, 12)
    palette = Palette([frame], COLOURS)
    assert (palette.colours[palette.indices(frame)] == frame).all()
