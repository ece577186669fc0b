import numpy as np
import pytest
from matplotlib.figure import Figure

from sada_gym.analyses.plots.style import png
from sada_gym.board.results.charts import (
    NOVELTY_PANELS,
    Curve,
    _spread,
    anytime_curves,
    label_ends,
    marginal_strips,
    novelty_ratios,
)
from sada_gym.board.results.front import place_labels
from sada_gym.parameters import Parameter, ParameterSpace


def crowd(count, spread, seed=0):
    rng = np.random.default_rng(seed)
    return np.clip(rng.normal(0.7, spread, (count, 2)), 0, 1)


def canvas():
    figure = Figure(figsize=(8, 6), dpi=100, layout="constrained")
    axes = figure.subplots()
    axes.set_xlim(0, 1.1)
    axes.set_ylim(0, 1.1)
    return figure, axes


def boxes(labels):
    return np.array([label.get_window_extent().extents for label in labels])


def overlapping(frames):
    low = np.maximum(frames[:, None, :2], frames[None, :, :2])
    high = np.minimum(frames[:, None, 2:], frames[None, :, 2:])
    area = np.prod(np.maximum(high - low, 0), axis=2)
    return int((area[np.triu_indices(len(frames), 1)] > 0).sum())


FRAME = (50.0, 30.0, 850.0, 630.0)


@pytest.mark.parametrize("spread", [0.0, 0.01, 0.05, 0.2])
def test_no_name_lies_over_another_or_over_a_point(spread):
    points = crowd(17, spread) * [800, 600] + [50, 30]
    sizes = np.full((17, 2), [105.0, 15.0])
    middles = place_labels(points, sizes, FRAME)
    frames = np.concatenate([middles - sizes / 2, middles + sizes / 2], axis=1)
    assert overlapping(frames) == 0
    for box in frames:
        inside = ((points > box[:2]) & (points < box[2:])).all(axis=1)
        assert not inside.any()
    assert (frames[:, :2] >= np.array(FRAME[:2]) - 1).all()
    assert (frames[:, 2:] <= np.array(FRAME[2:]) + 1).all()


def test_a_lone_name_stands_close_by():
    point = np.array([[400.0, 300.0]])
    middles = place_labels(point, np.array([[24.0, 15.0]]), FRAME)
    assert np.linalg.norm(middles - point) < 40


@pytest.mark.parametrize("spread", [0.0, 0.05])
def test_names_of_lines_keep_their_order_and_apart(spread):
    _, axes = canvas()
    ends = crowd(9, spread)
    labels = label_ends(axes, ends, list("abcdefghi"), ["black"] * 9)
    frames = boxes(labels)
    assert overlapping(frames) == 0
    heights = frames[:, [1, 3]].mean(axis=1)
    order = np.argsort(ends[:, 1], kind="stable")
    assert (np.diff(heights[order]) > 0).all()
    assert (frames[:, 0] > axes.get_window_extent().x1).all()


def test_heights_move_no_farther_than_need_be():
    np.testing.assert_allclose(_spread(np.array([5.0, 50.0]), 10, 0, 100), [5, 50])
    np.testing.assert_allclose(_spread(np.array([52.0, 50.0]), 10, 0, 100), [56, 46])
    np.testing.assert_allclose(_spread(np.array([99.0, 99.0, 1.0]), 10, 0, 100), [90, 100, 1])


def test_the_charts_draw_without_a_warning(recwarn):
    queries = np.array([100.0, 200.0])
    space = ParameterSpace(*(Parameter(f"x{i}", -1, 1) for i in range(18)))
    mu = np.random.default_rng(0).uniform(-1, 1, (50, 18)).astype(np.float32)
    figures = [
        anytime_curves([Curve(("a", "b", "c"), queries, queries / 3, None)], "one"),
        anytime_curves(
            [Curve((name,), queries, queries / 2, queries / 300) for name in ("level-set", "mine")],
            "two",
        ),
        marginal_strips(space, {"random": mu}, None, "many"),
        novelty_ratios(
            {
                "a": dict(zip(NOVELTY_PANELS, ([1.0, 0.5], [0.9], []), strict=True)),
                "b": dict(zip(NOVELTY_PANELS, ([0.0], [], [1.0]), strict=True)),
            },
            "n",
        ),
    ]
    for figure in figures:
        assert png(figure).startswith(b"\x89PNG")
    assert [str(warning.message) for warning in recwarn] == []
    shown = [text.get_text() for text in figures[0].texts] + [figures[0].get_suptitle()]
    assert any("* a, b, c" in text for text in shown)
    assert "the first 16 of 18 parameters" in figures[2].get_suptitle()
