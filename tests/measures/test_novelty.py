import numpy as np
import pytest
from toy import Blind, Toy

from sada_gym.analyses.plots.novelty import novelty_sheet
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.measures.novelty import image_neighbours, novelty, relative_novelty


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_distances_to_the_nearest_query():
    queries = [[0.0, 0.0], [1.0, 1.0]]
    got = novelty([[0.0, 0.5], [0.0, 0.0], [1.0, 0.9]], queries)
    assert got.median == pytest.approx(0.1)
    assert got.fifth_percentile == pytest.approx(0.01)
    assert (got.minimum, got.repeats) == (0.0, 1)


def test_a_query_is_repeated_where_float32_says_so():
    assert novelty([[0.1 + 1e-12]], [[np.float32(0.1)]]).repeats == 1
    assert novelty([[-0.0]], [[0.0]]).repeats == 1
    assert novelty([[np.nextafter(np.float32(0.1), np.float32(1))]], [[0.1]]).repeats == 0


def test_bad_points_are_refused():
    with pytest.raises(ValueError, match="at least one sample"):
        novelty(np.zeros((0, 2)), np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"got \(1, 2\) and \(3, 3\)"):
        novelty(np.zeros((1, 2)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="that were not queried, got 3"):
        relative_novelty(np.ones((3, 2)), np.zeros((3, 2)), np.zeros((1, 2)))


@pytest.mark.parametrize("dimension", [2, 8, 64])
def test_an_archive_shows_and_the_truth_does_not(rng, dimension):
    application = AnalyticApplication(dimension=dimension, volume=0.1)
    queries = rng.uniform(-1, 1, (5_000, dimension)).astype(np.float32)
    fooling = queries[application.fooling_region(queries) >= 0]
    ideal, fresh = (application.sample_fooling_set(250, rng) for _ in range(2))
    archive = fooling[rng.choice(len(fooling), 250, replace=False)]
    shaken = np.clip(archive + 1e-4 * rng.normal(size=archive.shape), -1, 1)

    copied = relative_novelty(archive, ideal, queries)
    assert (copied.ratio, copied.repeats) == (0.0, 250)
    jittered = relative_novelty(shaken, ideal, queries)
    assert jittered.ratio < 0.03
    assert jittered.repeats < 25  # those at the box's edge
    truth = relative_novelty(fresh, ideal, queries)
    assert truth.ratio == pytest.approx(1.0, abs=0.15)
    assert truth.fifth_ratio == pytest.approx(1.0, abs=0.5)
    assert truth.repeats == 0

    half = np.concatenate([shaken[:100], fresh[:150]])
    assert relative_novelty(half, ideal, queries).fifth_ratio < 0.1


class Wheel(Toy):
    """Its image is a function of the first parameter's square and of the seed."""

    def __init__(self):
        super().__init__(2)
        self.drawn = []

    def render(self, mu, seed):
        self.drawn.append(seed)
        return np.full((4, 6, 3), round(200 * float(mu[0]) ** 2) + seed, np.uint8)


def test_the_nearest_image_is_not_the_nearest_mu():
    queries = [[0.5, 0.0], [-0.9, 0.0], [0.0, 1.0]]
    wheel = Wheel()
    (got,) = image_neighbours(wheel, [[0.8, 0.0]], [7], queries)
    assert got.mu.tolist() == pytest.approx([0.8, 0.0])
    assert (got.in_mu.query, got.in_image.query) == (0, 1)
    assert got.in_mu.mu_distance == pytest.approx(0.3)
    assert got.in_image.mu_distance == pytest.approx(1.7)
    # the images are 135, 57 and 169 throughout
    assert got.in_mu.pixel_distance == pytest.approx((135 - 57) / 127.5)
    assert got.in_image.pixel_distance == pytest.approx((169 - 135) / 127.5)
    assert got.in_image.image_distance == pytest.approx(34 / 127.5 * np.sqrt(4 * 6 * 3))
    assert got.seed == 7
    assert set(wheel.drawn) == {7}


def test_images_are_drawn_of_the_nearest_and_some_random_queries(rng):
    queries = rng.uniform(-1, 1, (100, 2))
    wheel = Wheel()
    samples = [[0.1, 0.1], [0.5, 0.5]]
    first = image_neighbours(wheel, samples, [1, 2], queries, neighbours=3, others=4)
    assert wheel.drawn == [1] * 8 + [2] * 8
    again = image_neighbours(Wheel(), samples, [1, 2], queries, neighbours=3, others=4)
    assert [n.in_image.query for n in first] == [n.in_image.query for n in again]
    wheel.drawn.clear()
    image_neighbours(wheel, samples[:1], [1], queries[:2])
    assert len(wheel.drawn) == 3


def test_a_sample_that_is_a_query_has_no_distance():
    (got,) = image_neighbours(Wheel(), [[0.3, 0.3]], [0], [[0.9, 0.3], [0.3, 0.3]])
    assert got.in_mu.query == got.in_image.query == 1
    assert got.in_mu.mu_distance == got.in_mu.image_distance == got.in_image.pixel_distance == 0.0


def test_without_images_there_are_no_neighbours():
    assert image_neighbours(Blind(2), np.zeros((3, 2)), [0, 1, 2], np.zeros((5, 2))) == ()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": [1, 2]}, "Expected 1 seeds"),
        ({"queries": np.zeros((0, 2))}, "at least 1 query"),
        ({"neighbours": 0}, "neighbours >= 1"),
        ({"others": -1}, "others >= 0"),
        ({"samples": np.zeros((1, 3))}, "Expected mu of shape"),
    ],
)
def test_bad_requests_are_refused(changes, message):
    arguments = {"samples": np.zeros((1, 2)), "seeds": [1], "queries": np.ones((3, 2))} | changes
    with pytest.raises(ValueError, match=message):
        image_neighbours(Wheel(), **arguments)


def test_the_view_is_what_the_detector_sees():
    seen = []
    detector = DetectionApplication("car").agent
    application = DetectionApplication(
        "car",
        agent=lambda images: seen.extend(images) or detector(images),
        labels=detector.labels,
    )
    mu = np.zeros(8, np.float32)
    application.evaluate(mu[None], [3])
    shown = (255 * seen[0].permute(1, 2, 0)).round().numpy()
    np.testing.assert_array_equal(application.observation(mu, 3), shown)
    assert application.render(mu, 3).shape != shown.shape


def test_the_sheet_has_three_images_a_sample_and_both_sides_in_a_row(rng):
    neighbours = image_neighbours(Toy(2), rng.uniform(-1, 1, (4, 2)), range(4), np.ones((3, 2)))
    sheet = novelty_sheet(neighbours[:2], neighbours[2:])
    titles = [axes.get_title() for axes in sheet.axes]
    assert [title.split(" (")[0] for title in titles[:6]] == [
        "adversary's sample",
        "nearest in μ",
        "nearest image",
        "ideal sample",
        "nearest in μ",
        "nearest image",
    ]
    assert f"({neighbours[0].in_mu.mu_distance:.2f}, " in titles[1]
    assert len(titles) == 12
    alone = novelty_sheet(neighbours[:1])
    assert [axes.get_title()[:9] for axes in alone.axes] == ["adversary", "nearest i", "nearest i"]


@pytest.mark.parametrize(("ours", "ideal"), [(0, 0), (2, 1)])
def test_uneven_sheets_are_refused(ours, ideal):
    (neighbours,) = image_neighbours(Toy(2), np.zeros((1, 2)), [0], np.ones((3, 2)))
    with pytest.raises(ValueError, match=f"got {ours} and {ideal}"):
        novelty_sheet([neighbours] * ours, [neighbours] * ideal)
