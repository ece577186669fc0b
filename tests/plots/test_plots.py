import sys

import numpy as np
import pytest
from toy import Blind, Toy

from sada_gym.oracle import Evaluations
from sada_gym.parameters import Parameter, ParameterSpace
from sada_gym.plots.attack import (
    axis_label,
    contact_sheet,
    draw_attack,
    marginals,
    score_histogram,
)

PNG = b"\x89PNG\r\n\x1a\n"


def drawn(n, dimension=3, seed=0):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (n, dimension)).astype(np.float32)
    return Evaluations(mu, rng.random(n), rng.integers(2**31, size=n))


def test_all_pictures(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it would raise
    names = [path.name for path in draw_attack(Toy(), drawn(50), drawn(200), tmp_path)]
    assert names == ["marginals.png", "scores.png", "fooled.png"]
    for name in names:
        assert (tmp_path / name).read_bytes().startswith(PNG)


def test_the_same_data_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        draw_attack(Toy(2), drawn(30, 2), drawn(90, 2), tmp_path / name)
    for picture in (tmp_path / "a").iterdir():
        assert picture.read_bytes() == (tmp_path / "b" / picture.name).read_bytes()


@pytest.mark.parametrize("dimension", [1, 5])
def test_any_dimension(dimension, tmp_path):
    pictures = draw_attack(Toy(dimension), drawn(20, dimension), drawn(0, dimension), tmp_path)
    assert ("map.png" in {path.name for path in pictures}) == (dimension == 2)


def test_no_contact_sheet_without_frames_or_fooled_samples(tmp_path):
    unhurt = drawn(20)
    unhurt.score[:] = 1.0
    with pytest.warns(UserWarning, match="No frames are drawn. Blind draws no pictures"):
        blind = draw_attack(Blind(), drawn(20), drawn(9), tmp_path)
    for pictures in (blind, draw_attack(Toy(), unhurt, drawn(9), tmp_path)):
        assert {path.name for path in pictures} == {"marginals.png", "scores.png"}


def test_marginals_show_physical_units_and_shares():
    space = ParameterSpace(Parameter("height_m", 2.0, 4.0, "m"))
    samples = drawn(40, 1)
    axes = marginals(space, samples, 0.3).axes[0]
    assert axes.get_xlim() == (2.0, 4.0)
    assert axes.get_xlabel() == "height (m)"
    tops = {}
    for bar in axes.patches:
        tops[bar.get_x()] = max(tops.get(bar.get_x(), 0.0), bar.get_y() + bar.get_height())
    assert sum(tops.values()) == pytest.approx(100.0)


def test_the_histogram_takes_scores_beyond_one():
    samples = drawn(10)
    samples.score[0] = 3.0
    assert score_histogram(samples, drawn(0), 0.3).axes[0].get_xlim() == (0.0, 3.0)


def test_a_contact_sheet_of_one():
    sheet = contact_sheet([np.zeros((4, 4, 3), np.uint8)], ["Q = 0.10"], "one")
    assert sheet.axes[0].get_title() == "Q = 0.10"


@pytest.mark.parametrize(
    ("parameter", "label"),
    [
        (Parameter("camera_azimuth_deg", 0, 1, "deg"), "camera azimuth (°)"),
        (Parameter("colour_red", 0, 1), "colour red"),
        (Parameter("distance", 0, 1, "m"), "distance (m)"),
    ],
)
def test_labels(parameter, label):
    assert axis_label(parameter) == label
