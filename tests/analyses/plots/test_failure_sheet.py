from typing import get_args

import numpy as np
import pytest
from PIL import Image, ImageDraw

from sada_gym.analyses.plots.failure_sheet import WIDTH, FrameGroup, columns_for, failure_sheet
from sada_gym.foundations.drawing import dashed, font, swatch, wrapped
from sada_gym.foundations.frames import LegendEntry, Mark

FRAME = np.full((40, 60, 3), (10, 200, 30), np.uint8)
LEGEND = (
    LegendEntry("the true box", "#ff00ff", "dashed box"),
    LegendEntry("a remark without a mark"),
)


def sheet(counts=(3, 3, 1), **changes):
    groups = [
        FrameGroup(f"Group {i}", "a note", [FRAME] * n, ["Q"] * n) for i, n in enumerate(counts)
    ]
    arguments = {"columns": 3, "legend": LEGEND, "title": "Some failures"} | changes
    return np.asarray(failure_sheet(groups, **arguments))


def test_a_sheet_shows_all_frames_and_the_legend():
    shown = sheet()
    assert shown.shape[1] == WIDTH
    green = (np.abs(shown.astype(int) - FRAME[0, 0]) < 8).all(axis=-1)
    assert green.sum() / (437 * 437 * 40 / 60) == pytest.approx(7, rel=0.02)
    magenta = (shown == (255, 0, 255)).all(axis=-1)
    assert magenta.any()
    assert np.flatnonzero(magenta.any(axis=1)).max() < np.flatnonzero(green.any(axis=1)).min()
    assert not (sheet(legend=()) == (255, 0, 255)).all(axis=-1).any()


def test_an_empty_group_takes_no_room():
    assert sheet((3, 0, 0)).shape == sheet((0, 3, 0)).shape
    assert len(sheet((3, 0, 0))) < len(sheet((3, 3, 0)))


def test_a_long_headline_is_broken_into_lines():
    heights = [len(sheet(headline=text)) for text in ("", "a word", "a long sentence " * 20)]
    assert heights[0] < heights[1] < heights[2]


def test_what_follows_a_captions_first_line_is_smaller():
    heights = []
    for caption in ("Q", "Q\na", "Q\na\nb"):
        group = FrameGroup("All", "", [FRAME], [caption])
        heights.append(failure_sheet([group], 3, (), "One").height)
    one, two, three = heights
    assert two - one == three - two == round(1.35 * 20)


def test_frames_of_any_shape_fit():
    frames = [np.zeros(shape, np.uint8) for shape in ((1, 1, 3), (900, 20, 3), (20, 2000, 3))]
    group = FrameGroup(
        "All", "", frames, ["one", "two\nlines", "a caption that is far too long " * 4]
    )
    assert failure_sheet([group], 3, (), "Odd frames").width == WIDTH


@pytest.mark.parametrize(("width", "columns"), [(128, 4), (384, 3), (450, 3), (896, 2), (3000, 2)])
def test_wider_frames_are_fewer_in_a_row(width, columns):
    frame = np.zeros((100, width, 3), np.uint8)
    assert columns_for(frame) == columns
    assert columns_for(frame, plain=True) == 3


def test_lines_are_broken_between_words_and_long_words_anywhere():
    of = font(20)
    assert wrapped("one two", of, 1000) == ["one two"]
    lines = wrapped("some words /a/very/long/path/without/a/space and more", of, 150)
    assert all(of.getlength(line) <= 150 for line in lines)
    assert "".join(lines).replace(" ", "") == "somewords/a/very/long/path/without/a/spaceandmore"
    assert wrapped("one\ntwo", of, 1000) == ["one", "two"]
    assert wrapped("", of, 100) == []


def test_the_font_has_greek_and_accents():
    of = font(20)
    missing = bytes(of.getmask("\ue000"))
    assert all(bytes(of.getmask(sign)) != missing for sign in "μ≤éüЖ…")


def test_a_dashed_line_has_gaps():
    drawn = []
    for gap in (0, 6):
        picture = Image.new("L", (100, 9))
        dashed(ImageDraw.Draw(picture), [(0, 4), (50, 4), (99, 4)], 255, 3, 6, gap)
        drawn.append((np.asarray(picture)[4] > 0).mean())
    assert drawn[0] == 1.0
    assert 0.4 < drawn[1] < 0.75


def test_marks_of_one_colour_differ_by_their_shape():
    marks = [mark for mark in get_args(Mark) if mark != "note"]
    pictures = []
    for mark in marks:
        picture = Image.new("RGB", (48, 26), "white")
        swatch(ImageDraw.Draw(picture), LegendEntry("", "#0072b2", mark), (2, 2, 45, 23))
        pictures.append(np.asarray(picture).astype(int))
    for i, drawn in enumerate(pictures):
        assert (drawn != 255).any()
        for other in pictures[:i]:
            assert (np.abs(drawn - other).max(axis=-1) > 60).sum() > 20


def test_a_figure_stays_beside_its_percent_sign():
    face = font(12)
    text = "of its samples fool 92 % and more"
    lines = [wrapped(text, face, width) for width in range(60, 300)]
    assert any(len(line) > 1 for line in lines)
    assert not any(word.startswith("%") for line in lines for word in line)
