"""Densities of worlds in ordinary use: what they say, what they draw, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sada_gym.densities import Density, WorldDensity
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.rates import weighted_rate
from sada_gym.parameters import Parameter, ParameterSpace

NORMAL = {"normal": [9.8, 0.5]}
SPACE = ParameterSpace(
    Parameter("gravity", 8.0, 12.0),
    Parameter("friction", 0.01, 10.0, log=True),
    Parameter("lanes", 1.5, 6.5, choices=("2", "3", "4", "5", "6"), whole=True),
    Parameter("cars", -0.5, 99.5, whole=True),
    Parameter("weather", 0.0, 3.0, choices=("sun", "rain", "hail")),
    Parameter("wind", 0.0, 1.0),
)


def world(**data):
    return WorldDensity(SPACE, {name: Density(given) for name, given in data.items()})


@pytest.mark.parametrize(
    ("name", "data", "truth"),
    [
        ("gravity", NORMAL, stats.truncnorm(-3.6, 4.4, 9.8, 0.5)),
        ("gravity", {"uniform": [9.0, 10]}, stats.uniform(9.0, 1.0)),
        ("gravity", {"truncated-normal": [9, 1, 9, 10]}, stats.truncnorm(0, 1, 9, 1)),
        ("gravity", {"values": [8, 9, 12], "weights": [0, 1, 0]}, stats.triang(0.25, 8, 4)),
        ("friction", {"normal": [1.0, 0.2]}, stats.truncnorm(-4.95, 45, 1.0, 0.2)),
    ],
)
def test_a_density_is_what_it_says_and_draws_so(name, data, truth):
    density, column = world(**{name: data}), SPACE.names.index(name)
    mu = np.zeros((200, len(SPACE)), np.float32)
    mu[:, column] = np.linspace(-0.999, 0.999, 200)
    values = SPACE.physical(mu)[:, column]
    slope = np.gradient(values, mu[:, column].astype(float))
    expected = truth.pdf(values) * slope / 2 ** (len(SPACE) - 1)
    found = np.exp(density.log_density(mu))
    inside = slice(2, -2)
    assert found[inside] == pytest.approx(expected[inside], rel=0.03, abs=1e-3)
    drawn = density.sample(4_000, np.random.default_rng(0))
    assert np.abs(drawn).max() <= 1.0
    assert stats.kstest(SPACE.physical(drawn)[:, column], truth.cdf).pvalue > 1e-3
    assert stats.kstest((drawn[:, 5] + 1) / 2, "uniform").pvalue > 1e-3


@pytest.mark.parametrize(
    "data",
    [
        {"normal": [-30.0, 10.0]},
        {"truncated-normal": [690.0, 10.0, 600.0, 780.0]},
        {"uniform": [-47.32, -12.68]},
        {"values": [-54.5, -30.0, -5.5], "weights": [0, 1, 0]},
    ],
)
def test_an_angle_goes_around(data):
    heading = Parameter("heading_deg", 0.0, 360.0, "deg", directions=("n", "w", "s", "e"))
    for low in (0.0, -180.0, -25.0):
        space = ParameterSpace(replace(heading, low=low, high=low + 360.0))
        density = WorldDensity(space, {"heading_deg": Density(data)})
        assert density.held == pytest.approx(1.0)
        values = space.physical(density.sample(20_000, np.random.default_rng(0)))[:, 0]
        near = (values + 30.0 + 180.0) % 360.0 - 180.0
        assert near.mean() == pytest.approx(0.0, abs=0.5)
        assert near.std() == pytest.approx(10.0, rel=0.03)


@pytest.mark.parametrize(
    ("name", "data", "low", "high"),
    [
        ("gravity", {"uniform": [9.7003, 9.9001]}, 9.7003, 9.9001),
        ("gravity", {"uniform": [9.7003, 9.7004]}, 9.7003, 9.7004),  # narrower than a cell
        ("gravity", {"uniform": [10.0, 11.0]}, 10.0, 11.0),  # ends at edges of cells
        ("gravity", {"uniform": [0.0, 9.0]}, 8.0, 9.0),
        ("gravity", {"truncated-normal": [9, 1, 9.0001, 10]}, 9.0001, 10.0),
        ("gravity", {"values": [9.0001, 9.5, 10], "weights": [1, 1, 2]}, 9.0001, 10.0),
        ("friction", {"uniform": [0.0123, 0.5]}, 0.0123, 0.5),
    ],
)
def test_nothing_is_drawn_outside_a_density(name, data, low, high):
    density, column = world(**{name: data}), SPACE.names.index(name)
    drawn = density.sample(20_000, np.random.default_rng(0))
    values = SPACE.physical(drawn)[:, column]
    slack = 2e-6  # mu is rounded to float32
    assert low - slack <= values.min() < values.max() <= high + slack
    inner = (values > low + slack) & (values < high - slack)
    assert np.isfinite(density.log_density(drawn[inner])).all()


@pytest.mark.parametrize(
    ("name", "data", "truth"),
    [
        ("lanes", {"values": [2, 4, 9], "weights": [1, 2, 1]}, [1 / 3, 0, 2 / 3, 0, 0]),
        (
            "lanes",
            {"normal": [4, 1]},
            np.diff(stats.truncnorm(-2.5, 2.5, 4).cdf(np.arange(6) + 1.5)),
        ),
        ("weather", {"values": ["rain", "sun"], "weights": [1, 3]}, [0.75, 0.25, 0]),
    ],
)
def test_choices_and_whole_numbers_have_probabilities(name, data, truth):
    density, column = world(**{name: data}), SPACE.names.index(name)
    drawn = density.sample(4_000, np.random.default_rng(0))
    parts = len(truth)
    place = np.minimum((drawn[:, column] + 1) / 2 * parts, parts - 1).astype(int)
    assert np.bincount(place, minlength=parts) / 4_000 == pytest.approx(truth, abs=0.03)
    middle = np.zeros((parts, len(SPACE)), np.float32)
    middle[:, column] = (2 * np.arange(parts) + 1) / parts - 1
    relative = np.exp(density.log_density(middle)) * 2 ** len(SPACE) / parts
    assert relative == pytest.approx(truth, abs=1e-6)


def test_a_density_is_cut_off_at_the_ends_of_the_range():
    assert world(gravity={"normal": [8.0, 0.5]}).held == pytest.approx(0.5)
    assert world(gravity=NORMAL).held > 0.999


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"normal": [0.0]},
        {"normal": [0.0, 0.0]},
        {"normal": [0.0, np.nan]},
        {"normal": ["a", 1]},
        {"normal": 3},
        {"gauss": [0.0, 1.0]},
        {"uniform": [1.0, 1.0]},
        {"truncated-normal": [0.0, 1.0, 2.0, 1.0]},
        {"normal": [0.0, 1.0], "uniform": [0.0, 1.0]},
        {"values": [1, 2], "weights": [1]},
        {"values": [1, 2], "weights": [0, 0]},
        {"values": [1, 2], "weights": [2, -1]},
        {"values": [], "weights": []},
        {"values": 3, "weights": [1]},
        {"values": [1, 2]},
    ],
)
def test_what_is_no_density_gets_a_sentence(data):
    with pytest.raises(ValueError, match=r"Expected a density as .*normal.*got \{"):
        Density(data)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("gravity", {"normal": [50.0, 1.0]}, "hold a thousandth of its density"),
        ("gravity", {"values": [9.0], "weights": [1.0]}, "at least two values .* 'gravity'"),
        ("gravity", {"values": [10.0, 9.0], "weights": [1.0, 1.0]}, "ascending order"),
        ("gravity", {"values": ["a", "b"], "weights": [1.0, 1.0]}, "at least two values"),
        ("weather", {"normal": [1.0, 1.0]}, "whose values are sun, rain, hail"),
        ("weather", {"values": ["snow"], "weights": [1]}, "among sun, rain, hail, got 'snow'"),
        ("lanes", {"values": [9], "weights": [1]}, "hold a thousandth"),
    ],
)
def test_what_does_not_fit_its_parameter_gets_a_sentence(name, data, message):
    with pytest.raises(ValueError, match=message):
        world(**{name: data})


def test_the_interval_of_a_weighted_rate_holds_a_known_probability():
    density = WorldDensity(
        ParameterSpace(SPACE.parameters[0], SPACE.parameters[5]),
        {"gravity": Density(NORMAL)},
    )
    truth = float(stats.truncnorm(-3.6, 4.4, 9.8, 0.5).sf(10.3))  # 0.158; uniform worlds 0.425
    held, rates = 0, []
    for seed in range(200):
        mu = np.random.default_rng(seed).uniform(-1, 1, (400, 2)).astype(np.float32)
        fooled = density.space.physical(mu)[:, 0] > 10.3
        rate = weighted_rate(fooled, density.log_density(mu))
        held += rate.low <= truth <= rate.high
        rates.append(rate.rate)
        assert rate.worth < 400
    assert np.mean(rates) == pytest.approx(truth, abs=0.005)
    assert held >= 184


def test_a_rate_without_weights_or_failures():
    assert weighted_rate([True, False], [-np.inf, -np.inf]) is None
    assert weighted_rate([], []) is None
    none = weighted_rate(np.zeros(100, bool), np.zeros(100))
    assert (none.rate, none.low, none.worth) == (0.0, 0.0, pytest.approx(100))
    assert none.high == pytest.approx(0.037, abs=1e-3)
    same = weighted_rate([True] * 30 + [False] * 70, np.zeros(100))
    assert (same.rate, same.worth) == (pytest.approx(0.3), pytest.approx(100))
    one = weighted_rate([True, False], [0.0, -np.inf])
    assert one.high - one.low > 0.5


@pytest.mark.parametrize(("sd", "worlds"), [(0.5, 200), (0.2, 800)])
def test_intervals_of_the_failure_probability_hold_a_known_truth_as_often_as_they_say(sd, worlds):
    application = AnalyticApplication(dimension=3, regions=2)
    density = Density({"normal": [0.3, sd]})
    names = application.parameters.names
    in_use = WorldDensity(application.parameters, dict.fromkeys(names, density))
    # of a box of the fooling set, of which each side counts by itself
    ends = application.centres[:, None] + application.half_sides * np.array([[-1.0], [1.0]])
    inside = np.diff(density.below(ends.clip(-1.0, 1.0)), axis=1)[:, 0].prod(axis=1).sum()
    truth = inside / np.diff(density.below(np.array([-1.0, 1.0])))[0] ** 3
    held, rates = 0, []
    for seed in range(200):
        mu = np.random.default_rng(seed).uniform(-1, 1, (worlds, 3)).astype(np.float32)
        rate = weighted_rate(application.fooling_region(mu) >= 0, in_use.log_density(mu))
        held += rate.low <= truth <= rate.high
        rates.append(rate.rate)
    assert held >= 0.92 * 200
    assert np.mean(rates) == pytest.approx(truth, abs=3 * np.std(rates) / 200**0.5)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("gravity", NORMAL),
        ("gravity", {"values": [8, 9, 10, 12], "weights": [1, 0, 0, 1]}),  # a gap
        ("friction", {"normal": [1.0, 0.2]}),
        ("lanes", {"values": [2, 4, 9], "weights": [1, 2, 1]}),
        ("wind", None),
    ],
)
def test_standard_normal_numbers_become_worlds_of_ordinary_use_and_back(name, data):
    density, column = world(**({name: data} if data else {})), SPACE.names.index(name)
    z = np.random.default_rng(0).normal(size=(4_000, len(SPACE)))
    mu = density.from_normal(z)
    assert np.abs(mu).max() <= 1.0
    drawn = density.sample(4_000, np.random.default_rng(1))
    assert stats.ks_2samp(mu[:, column], drawn[:, column]).pvalue > 1e-3
    assert np.isfinite(density.log_density(mu)).all()
    back = density.to_normal(mu)
    near = np.abs(z).max(axis=1) < 3.0  # mu is rounded to float32
    assert back[near] == pytest.approx(z[near], abs=1e-2)
