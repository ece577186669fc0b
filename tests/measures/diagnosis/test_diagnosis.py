"""From known worlds to weaknesses: planted ones are found, and nothing in noise."""

import re

import numpy as np
import pytest

from sada_gym import Parameter, ParameterSpace
from sada_gym.evaluations import Evaluations
from sada_gym.measures.diagnosis.checking import Checker
from sada_gym.measures.diagnosis.core import diagnose_worlds
from sada_gym.measures.diagnosis.record import Condition
from sada_gym.measures.diagnosis.rules import holds

AROUND = ("in front", "on the left", "behind", "on the right")
SPACE = ParameterSpace(
    Parameter("camera_azimuth_deg", -180.0, 180.0, "deg", directions=AROUND),
    Parameter("camera_pitch_deg", 0.0, 50.0, "deg"),
    Parameter("payload_kg", 0.0, 5.0, "kg"),
    Parameter("trailer_kg", 0.0, 10.0, "kg"),
    Parameter("weather", 0.0, 4.0, choices=("sun", "rain", "fog", "snow")),
    Parameter("cars", 0.5, 10.5, whole=True),
    Parameter("friction", 0.01, 1.0, log=True),
)


SQUARE = ParameterSpace(Parameter("x", -1.0, 1.0), Parameter("y", -1.0, 1.0))
RIGHT = [Condition(parameter="x", ranges=((0.0, 1.0),), text="x is above 0")]
TOP = [Condition(parameter="y", ranges=((0.0, 1.0),), text="y is above 0")]


def column(values, name):
    return values[:, SPACE.names.index(name)]


def behind(values):
    return np.abs(column(values, "camera_azimuth_deg")) > 150


def steep(values):
    return column(values, "camera_pitch_deg") > 35


def heavy_in_fog(values):
    return (column(values, "payload_kg") > 3) & (np.floor(column(values, "weather")) == 2)


def crowded(values):
    return (np.rint(column(values, "cars")) >= 8) & (column(values, "friction") < 0.1)


def slanted(values):
    total = column(values, "payload_kg") + 0.5 * column(values, "trailer_kg")
    return (total > 4.5) & (total < 5.5)


def diagnose(*planted, n=2_000, inside=0.9, elsewhere=0.02, fresh=100, seed=0, **options):
    rng = np.random.default_rng(seed)

    def fooled(mu):
        values = SPACE.physical(mu)
        where = np.any([rule(values) for rule in planted], axis=0) if planted else False
        return rng.random(len(mu)) < np.where(where, inside, elsewhere)

    mu = rng.uniform(-1, 1, (n, len(SPACE))).astype(np.float32)
    known = Evaluations(mu, 1.0 - fooled(mu), np.arange(n))
    return diagnose_worlds(
        SPACE,
        known,
        0.5,
        np.ones(n, np.bool_),
        evaluate=lambda mu: (fooled(mu), np.ones(len(mu), np.bool_)),
        fresh=fresh,
        **options,
    )


def overlap(weakness, rule):
    mu = np.random.default_rng(9).uniform(-1, 1, (20_000, len(SPACE)))
    named, true = holds(weakness.conditions, SPACE, mu), rule(SPACE.physical(mu))
    return (named & true).sum() / (named | true).sum()


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (behind, ["camera is behind (beyond ±"]),
        (steep, ["camera pitch is above 35°"]),
        (heavy_in_fog, ["payload is above 3 kg", "weather is fog"]),
        (crowded, ["cars is at least 8", "friction is below 0.1"]),
        (
            slanted,
            [
                "payload is between 4.5 kg \N{MINUS SIGN} 0.5 \N{MULTIPLICATION SIGN} trailer and",
                " 5.5 kg \N{MINUS SIGN} 0.5 \N{MULTIPLICATION SIGN} trailer",
            ],
        ),
    ],
)
def test_a_planted_weakness_is_named(rule, words):
    [weakness] = diagnose(rule).weaknesses
    assert overlap(weakness, rule) > 0.8
    for part in words:
        assert part in weakness.text


def test_two_weaknesses_are_told_apart_with_their_figures():
    found = diagnose(behind, heavy_in_fog)
    assert len(found.weaknesses) == 2
    assert {overlap(one, behind) > 0.8 for one in found.weaknesses} == {True, False}
    for one in found.weaknesses:
        assert one.inside.interval_95[0] > 0.5 > one.outside.interval_95[1]
        assert one.inside.samples >= 30
        assert 0 < one.distinct <= one.failures
        for example in one.examples:
            assert holds(one.conditions, SPACE, [example.mu]).all()
    assert found.explained > 0.75
    assert found.fresh <= 100
    shares = [one.share for one in found.weaknesses]
    assert shares == sorted(shares, reverse=True)
    assert found.sentence.endswith("There is one more weakness.")


def test_a_diagonal_is_named_beside_a_stronger_weakness_of_its_parameter():
    def heavy(values):
        return column(values, "payload_kg") > 3.8

    def thin(values):
        total = column(values, "payload_kg") + 0.58 * column(values, "trailer_kg")
        return (total > 4) & (total < 4.4)

    texts = {one.text: one for one in diagnose(heavy, thin).weaknesses}
    [slanted] = [one for text, one in texts.items() if "trailer" in text]
    assert set(texts) == {"payload is above 3.8 kg", slanted.text}
    assert overlap(slanted, thin) > 0.7


def test_the_interval_of_a_threshold_holds_the_true_one():
    hits = []
    for seed in range(4):
        [weakness] = diagnose(steep, seed=seed, n=600, fresh=20).weaknesses
        [end] = weakness.thresholds
        assert end.interval_95[0] <= end.value <= end.interval_95[1]
        hits.append(end.interval_95[0] <= 35 <= end.interval_95[1])
    assert np.mean(hits) >= 0.75


def test_a_rule_is_a_weakness_once_fifteen_fresh_worlds_inside_and_outside_confirm_it():
    few = diagnose(steep, behind, n=200, fresh=10)
    assert 0 < few.fresh <= 10
    assert not any(one.is_checked for one in few.weaknesses)
    assert few.sentence.startswith("Perhaps fails where ")
    assert "not yet confirmed" in few.sentence
    enough = diagnose(steep, behind, n=200, fresh=10, enough=True)
    assert len(enough.weaknesses) == 2
    assert enough.sentence.startswith("Fails where ")
    assert 45 <= enough.fresh <= 15 * 8
    for one in enough.weaknesses:
        assert min(one.fresh) >= 15
        assert one.is_checked
        # the 200 uniform worlds that the run knew count, too
        assert one.outside.samples > 100


def test_worlds_that_broke_are_replaced_before_a_rule_is_confirmed():
    rng = np.random.default_rng(1)

    def evaluate(mu):
        return steep(SPACE.physical(mu)), rng.random(len(mu)) < 0.6

    mu = rng.uniform(-1, 1, (300, len(SPACE))).astype(np.float32)
    known = Evaluations(mu, np.where(steep(SPACE.physical(mu)), 0.0, 1.0), np.arange(300))
    uniform = np.ones(300, np.bool_)
    found = diagnose_worlds(SPACE, known, 0.5, uniform, evaluate=evaluate, enough=True, fresh=15)
    assert all(min(one.fresh) >= 15 for one in found.weaknesses)
    assert found.fresh > 30


def test_a_rate_weighs_worlds_by_how_densely_they_were_drawn():
    checker = Checker(
        SQUARE, [RIGHT, TOP], lambda mu: np.ones(len(mu), np.bool_), np.random.default_rng(0)
    )
    rates = []
    for seed in range(40):
        rng = np.random.default_rng(seed)

        def evaluate(mu, rng=rng):
            both = (mu > 0).all(axis=1)  # a corner that each of the two rules draws from
            return rng.random(len(mu)) < np.where(both, 1.0, 0.0), np.ones(len(mu), np.bool_)

        drawn = checker.spend(evaluate, 90, enough=True)
        rates.append(checker.rate(drawn, np.ones(len(drawn.mu), np.bool_)).rate)
    assert abs(np.mean(rates) - 0.25) < 0.02


@pytest.mark.parametrize(
    ("rate", "words"), [(1.0, "Every world fails"), (0.97, "Nearly every wor")]
)
def test_where_every_world_fails_it_says_so(rate, words):
    found = diagnose(n=300, elsewhere=rate)
    assert found.weaknesses == ()
    assert found.sentence.startswith(words)
    assert "of uniform worlds fool the agent" in found.sentence


def test_one_whole_number_is_told_as_one():
    [weakness] = diagnose(lambda values: np.rint(column(values, "cars")) == 7).weaknesses
    assert weakness.text == "cars is 7"


def _value(told, turbulence):
    """Compute `78 + 40 * turbulence`, as a rule tells it."""
    parts = re.fullmatch(r"(?:(-?[0-9.]+) ([+-]) )?(-?)(?:([0-9.]+) \* )?turbulence", told)
    start, sign, minus, factor = parts.groups()
    slope = float(factor or 1) * (-1 if "-" in (sign, minus) else 1)
    return float(start or 0) + slope * turbulence


@pytest.mark.parametrize("seed", range(4))
def test_a_sum_is_told_solved_for_one_parameter_and_holds_as_it_is_told(seed):
    rng = np.random.default_rng(seed)
    space = ParameterSpace(
        Parameter("turbulence", 0.0, float(rng.uniform(1, 3))), Parameter("speed", 20.0, 180.0)
    )
    slope = float(rng.uniform(20, 60)) * (1 if seed % 2 else -1)
    mu = rng.uniform(-1, 1, (2_000, 2)).astype(np.float32)
    turbulence, speed = space.physical(mu).T
    fooled = speed < 90.0 + slope * (turbulence - 0.5)
    known = Evaluations(mu, 1.0 - fooled, np.arange(2_000))
    weaknesses = diagnose_worlds(space, known, 0.5, np.ones(2_000, np.bool_)).weaknesses
    inside = [holds(weakness.conditions, space, mu) for weakness in weaknesses]
    assert (np.any(inside, axis=0) == fooled).mean() > 0.95
    told = [
        one for weakness in weaknesses for one in weakness.conditions if one.text.count(" ") > 3
    ]
    assert any(one.text.startswith("speed is below") for one in told)
    for one in told:
        text = one.text.replace("\N{MINUS SIGN}", "-").replace("\N{MULTIPLICATION SIGN}", "*")
        place, _, rest = text.removeprefix("speed is ").partition(" ")
        ends = [_value(end, turbulence) for end in rest.split(" and ")]
        said = speed < ends[-1] if place == "below" else speed > ends[0]
        if place == "between":
            said &= speed < ends[1]
        assert (said == holds([one], space, mu)).mean() > 0.999


def test_an_angle_is_not_cut_at_its_seam():
    angle = Parameter("wind_azimuth_deg", 0.0, 360.0, "deg", directions=AROUND)
    space = ParameterSpace(angle, Parameter("x", 0.0, 1.0))
    mu = np.random.default_rng(0).uniform(-1, 1, (1_000, 2)).astype(np.float32)
    azimuth = space.physical(mu)[:, 0]
    fooled = (azimuth > 340) | (azimuth < 20)
    known = Evaluations(mu, 1.0 - fooled, np.arange(1_000))
    [weakness] = diagnose_worlds(space, known, 0.5, np.ones(1_000, np.bool_)).weaknesses
    assert weakness.text == "wind is in front (above 340° or below 20°)"
    assert (holds(weakness.conditions, space, mu) == fooled).mean() > 0.99
    fooled = azimuth > 300  # up to the seam, and not below an angle that nothing is below
    known = Evaluations(mu, 1.0 - fooled, np.arange(1_000))
    [weakness] = diagnose_worlds(space, known, 0.5, np.ones(1_000, np.bool_)).weaknesses
    assert weakness.text.endswith("(300° to 360°)")


def test_noise_is_nowhere_in_particular():
    for seed in range(2):
        found = diagnose(elsewhere=0.1, seed=seed)
        assert found.weaknesses == ()
        assert found.sentence.startswith("Nowhere in particular")


def test_fresh_worlds_refuse_what_they_contradict():
    found = diagnose(steep, fresh=0)
    assert len(found.weaknesses) == 1
    assert found.weaknesses[0].inside is None
    assert found.fresh == 0
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (2_000, len(SPACE))).astype(np.float32)
    score = np.where(steep(SPACE.physical(mu)), 0.0, 1.0)
    refused = diagnose_worlds(
        SPACE,
        Evaluations(mu, score, np.arange(2_000)),
        0.5,
        np.ones(2_000, np.bool_),
        evaluate=lambda mu: (np.zeros(len(mu), np.bool_), np.ones(len(mu), np.bool_)),
        fresh=100,
    )
    assert refused.weaknesses == ()
    assert "Fresh worlds did not confirm" in refused.sentence


@pytest.mark.parametrize(("failures", "words"), [(0, "No world fooled"), (4, "Only 4 worlds")])
def test_too_few_failures_are_said_to_be_too_few(failures, words):
    mu = np.random.default_rng(0).uniform(-1, 1, (500, len(SPACE))).astype(np.float32)
    score = np.where(np.arange(500) < failures, 0.0, 1.0)
    known = Evaluations(mu, score, np.arange(500))
    found = diagnose_worlds(SPACE, known, 0.5, np.ones(500, np.bool_))
    assert words in found.sentence
    assert found.weaknesses == ()


def test_without_uniform_worlds_fresh_ones_say_how_often_it_fails_elsewhere():
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (3_000, len(SPACE))).astype(np.float32)
    steeper = steep(SPACE.physical(mu))
    mu = mu[steeper | (rng.random(3_000) < 0.1)]  # an adversary's choice
    true = steep(SPACE.physical(mu))
    found = diagnose_worlds(
        SPACE,
        Evaluations(mu, np.where(true, 0.0, 1.0), np.arange(len(mu))),
        0.5,
        np.zeros(len(mu), np.bool_),
        evaluate=lambda mu: (steep(SPACE.physical(mu)), np.ones(len(mu), np.bool_)),
        fresh=100,
    )
    [weakness] = found.weaknesses
    assert overlap(weakness, steep) > 0.9
    assert weakness.inside.rate == 1.0
    assert found.fresh <= 100


def test_invalid_worlds_are_no_failures_and_impossible_ones_are_not_asked_for():
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (2_000, len(SPACE))).astype(np.float32)
    broken = heavy_in_fog(SPACE.physical(mu))
    score = np.where(broken | steep(SPACE.physical(mu)), 0.0, 1.0)
    asked = []

    def evaluate(mu):
        asked.append(mu)
        return steep(SPACE.physical(mu)), np.ones(len(mu), np.bool_)

    found = diagnose_worlds(
        SPACE,
        Evaluations(mu, score, np.arange(2_000), broken),
        0.5,
        np.ones(2_000, np.bool_),
        evaluate=evaluate,
        fresh=100,
        permits=lambda mu: ~behind(SPACE.physical(mu)),
    )
    [weakness] = found.weaknesses
    assert overlap(weakness, steep) > 0.9
    assert not behind(SPACE.physical(np.concatenate(asked))).any()


def test_the_same_worlds_give_the_same_diagnosis():
    assert diagnose(crowded, n=500) == diagnose(crowded, n=500)
