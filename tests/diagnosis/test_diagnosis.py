"""From known worlds to weaknesses: planted ones are found, and nothing in noise."""

import numpy as np
import pytest

from sada_gym import Parameter, ParameterSpace
from sada_gym.diagnosis.core import diagnose_worlds
from sada_gym.diagnosis.rules import holds
from sada_gym.evaluations import Evaluations

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
        (slanted, ["payload + 0.5 \N{MULTIPLICATION SIGN} trailer is between"]),
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
    assert "Fresh worlds refused" in refused.sentence


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
