import numpy as np
import pytest
from scipy.optimize import minimize

from sada_gym.envs.uav.world.gates import CENTRE_HEIGHT_M, DEPTH_M, OUTER_WIDTH_M
from sada_gym.envs.uav.world.track import (
    GATES,
    LEAST_SPACING_M,
    LEAST_START_M,
    TEMPLATES,
    Template,
    Tracks,
    along,
    buildable,
    line,
    template,
)

COUNTS = tuple(TEMPLATES)


def tracks(anchors, mu):
    return TEMPLATES[anchors].tracks(mu)


def uniform(anchors, count, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 2 * anchors))


@pytest.mark.parametrize("anchors", COUNTS)
def test_gates_stand_at_equal_arc_length_and_face_along_the_track(anchors):
    flown = TEMPLATES[anchors].tracks(uniform(anchors, 1))
    fine, length = along(flown.anchors[0], np.linspace(0, 1, 60_001))
    step = np.hypot(*np.diff(fine[:, :2], axis=0).T)
    assert flown.length_m[0] == pytest.approx(step.sum(), rel=1e-4)
    assert length == flown.length_m[0]
    travelled = np.append(0, np.cumsum(step))
    tangent = np.arctan2(*np.diff(fine[:, :2], axis=0).T[::-1])
    for number, (x, y, z, heading) in enumerate(flown.gates[0]):
        nearest = np.argmin(np.hypot(fine[:-1, 0] - x, fine[:-1, 1] - y))
        expected = (number + 1) % GATES * travelled[-1] / GATES
        off = (travelled[nearest] - expected + 1) % travelled[-1] - 1
        assert abs(off) < 0.02
        assert np.cos(heading - tangent[nearest]) > 0.9999
        assert z == CENTRE_HEIGHT_M


def test_the_line_is_a_closed_quadratic_b_spline():
    anchors = np.array(TEMPLATES[4].anchors)
    path = line(anchors, 4_000)
    np.testing.assert_allclose(path[0], path[-1], atol=1e-9)
    # such a curve touches the anchors' polygon in the middle of every side
    for middle in (anchors + np.roll(anchors, 1, axis=0)) / 2:
        assert np.hypot(*(path - middle).T).min() < 0.02
    # and has 3/4 of the way to an anchor from the chord of the two middles
    middles = (anchors + np.roll(anchors, 1, axis=0)) / 2
    apex = anchors[0] / 2 + (middles[0] + middles[1]) / 4
    assert np.hypot(*(path - apex).T).min() < 0.02


@pytest.mark.parametrize("anchors", COUNTS)
def test_a_track_does_not_depend_on_the_others(anchors):
    mu = uniform(anchors, 9)
    together = tracks(anchors, mu)
    for i in (0, 4, 8):
        alone = tracks(anchors, mu[i : i + 1])
        np.testing.assert_array_equal(alone.gates[0], together.gates[i])
        np.testing.assert_array_equal(alone.starts[0], together.starts[i])


def border(gate):
    """Points on the border of a frame, seen from above."""
    t = np.linspace(-0.5, 0.5, 41)
    x = np.concatenate([t, t, np.full(41, 0.5), np.full(41, -0.5)]) * DEPTH_M
    y = np.concatenate([np.full(41, 0.5), np.full(41, -0.5), t, t]) * OUTER_WIDTH_M
    cosine, sine = np.cos(gate[3]), np.sin(gate[3])
    return gate[:2] + np.column_stack([x * cosine - y * sine, x * sine + y * cosine])


def test_distances_between_frames_are_those_of_their_borders():
    flown = tracks(5, uniform(5, 2))
    for gates, closest, away, start in zip(
        flown.gates, flown.closest_m(), flown.start_m(), flown.starts, strict=True
    ):
        borders = [border(gate) for gate in gates]
        pairs = [
            np.hypot(*(borders[i][:, None] - borders[j][None]).T).min()
            for i in range(GATES)
            for j in range(i)
        ]
        assert closest == pytest.approx(min(pairs), abs=0.05)
        to_start = min(np.hypot(*(b - start[:2]).T).min() for b in borders)
        assert away == pytest.approx(to_start, abs=0.05)


def test_frames_that_overlap_are_zero_apart():
    flown = tracks(3, np.zeros((1, 6)))
    for turn in (0.0, 0.3, 1.5):
        flown.gates[0, 5] = flown.gates[0, 2] + [0.4, 0.2, 0.0, turn]
        assert flown.closest_m()[0] == 0.0


def check(anchors, mu):
    flown = tracks(anchors, mu)
    assert flown.closest_m().min() >= LEAST_SPACING_M
    assert flown.start_m().min() >= LEAST_START_M


@pytest.mark.parametrize("anchors", COUNTS)
def test_random_tracks_are_valid(anchors):
    check(anchors, uniform(anchors, 1_000))
    check(anchors, np.sign(uniform(anchors, 500, seed=1)))


@pytest.mark.slow
@pytest.mark.parametrize("anchors", COUNTS)
def test_ten_thousand_random_tracks_are_valid(anchors):
    check(anchors, uniform(anchors, 10_000, seed=2))


def worst(chosen, what, *, tries, starts, seed):
    """Look for the mu at which a distance is smallest: random ones, the best of them improved."""
    dimension = len(chosen.parameters)
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (tries, dimension))
    mu[::2] = np.sign(mu[::2])

    def distance(at):
        return getattr(chosen.tracks(np.clip(at, -1, 1)[None]), what)()[0]

    distances = np.array([distance(at) for at in mu])
    least = distances.min()
    for i in np.argsort(distances)[:starts]:
        inward = mu[i] - 0.4 * np.diag(np.sign(mu[i]))
        simplex = np.vstack([mu[i], inward])
        options = {"maxfev": 400, "initial_simplex": simplex}
        least = min(least, minimize(distance, mu[i], method="Nelder-Mead", options=options).fun)
    return least


@pytest.mark.slow
@pytest.mark.parametrize("anchors", COUNTS)
def test_a_search_finds_no_invalid_track(anchors):
    chosen = template(anchors)
    assert worst(chosen, "closest_m", tries=1_500, starts=25, seed=3) >= LEAST_SPACING_M
    assert worst(chosen, "start_m", tries=1_500, starts=8, seed=3) >= LEAST_START_M


@pytest.mark.parametrize("anchors", COUNTS)
def test_few_tracks_are_drawn_back_and_no_further_than_they_must(anchors):
    chosen, mu = template(anchors), uniform(anchors, 1_000, seed=4)
    laid = chosen.tracks(mu)
    kept = laid.kept
    assert 0.02 < (kept < 1).mean() < 0.07
    home = np.array(chosen.anchors)
    for row in np.flatnonzero(kept < 1)[:5]:
        move = chosen.range_m * mu[row].astype(np.float32).astype(float).reshape(-1, 2)
        assert not buildable(Tracks((home + move)[None]))[0]
        alone = Tracks((home + kept[row] * move)[None])
        assert buildable(alone)[0]
        for name in ("anchors", "gates", "starts", "length_m"):
            np.testing.assert_array_equal(getattr(laid, name)[row], getattr(alone, name)[0])
        assert not buildable(Tracks((home + (kept[row] + 0.05) * move)[None]))[0]


@pytest.mark.slow
@pytest.mark.parametrize("anchors", COUNTS)
def test_the_range_is_the_widest_at_which_few_are_drawn_back(anchors):
    def share(range_m):
        wide = Template(TEMPLATES[anchors].anchors, range_m)
        return (wide.tracks(uniform(anchors, 10_000, seed=7)).kept < 1).mean()

    chosen = TEMPLATES[anchors].range_m
    assert share(chosen) <= 0.05 < share(chosen + 0.5)


def test_templates_are_easy():
    for anchors in COUNTS:
        flown = tracks(anchors, np.zeros((1, 2 * anchors)))
        assert flown.length_m[0] == pytest.approx(80, abs=0.5)
        assert np.abs(flown.turns_deg()).max() < 77
        assert flown.closest_m()[0] > 6


def test_turns_are_those_of_the_headings():
    flown = tracks(4, np.zeros((1, 8)))
    assert flown.turns_deg().sum() == pytest.approx(
        360 - np.rad2deg(flown.starts[0, 3] - flown.gates[0, -1, 3]) % 360
    )


@pytest.mark.parametrize("anchors", COUNTS)
def test_turns_count_loops(anchors):
    laid = TEMPLATES[anchors].tracks(uniform(anchors, 300))
    turns = laid.turns_deg()
    share = np.linspace(0, 1, 16 * 1_000 + 1)
    for anchor, turned in zip(laid.anchors, turns, strict=True):
        fine = np.rad2deg(np.unwrap(along(anchor, share)[0][:, 3]))
        np.testing.assert_allclose(turned, np.diff(fine[[1_000, *range(2_000, 16_001, 2_000)]]))
    assert (np.abs(turns).max() > 200) == (anchors > 3)


def test_mu_moves_the_anchors_by_the_range():
    chosen = template(4)
    moved = chosen.tracks([[0, 0, 1, 0, 0, -0.5, 0, 0]]).anchors[0] - chosen.anchors
    expected = np.zeros((4, 2))
    expected[1, 0], expected[2, 1] = chosen.range_m, -chosen.range_m / 2
    np.testing.assert_allclose(moved, expected)
    assert chosen.parameters.names[:3] == ("anchor_1_x_m", "anchor_1_y_m", "anchor_2_x_m")
    np.testing.assert_allclose(chosen.parameters.physical(np.ones(8)), chosen.range_m)


@pytest.mark.parametrize("anchors", [2, 6, True, "3", None])
def test_other_numbers_of_anchors_are_refused(anchors):
    with pytest.raises(ValueError, match=r"Expected anchors among 3, 4, 5, got"):
        template(anchors)
