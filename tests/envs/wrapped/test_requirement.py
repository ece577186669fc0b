"""Scores in signal temporal logic: against their definition, and what is refused."""

import math
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped.requirement import Requirement
from sada_gym.envs.wrapped.scores import Episode, as_score
from sada_gym.errors import InvalidWorld, UserError

pytest.importorskip("rtamt", reason="The extra stl brings rtamt, on Python below 3.13.")


def episode(**traces):
    """An episode whose infos hold traces of the same length."""
    length = len(next(iter(traces.values())))
    infos = tuple({name: trace[k] for name, trace in traces.items()} for k in range(length))
    observations = tuple(np.array([k, -k], float) for k in range(length))
    rewards = np.zeros(length - 1)
    return Episode(rewards, observations, (0,) * (length - 1), infos, False, True)


class Still:
    """Always pushes to the left."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(len(observation), int), state


def robustness(score, scale=1.0):
    """The inverse of a requirement's score."""
    side = 2.0 * score - 1.0
    return scale * side / (1.0 - abs(side))


def random_formula(draw, depth):
    """A formula, and its robustness at a step of traces, written from the definition of STL."""
    kind = draw.integers(6) if depth else 0
    if kind == 0:
        name, bound = str(draw.choice(["a", "b"])), round(float(draw.normal()), 3)
        if draw.random() < 0.5:
            return f"({name} > {bound})", lambda x, k: x[name][k] - bound
        return f"(abs({name}) < {bound})", lambda x, k: bound - abs(x[name][k])
    text, one = random_formula(draw, depth - 1)
    low, high = sorted(draw.integers(0, 6, 2).tolist())
    if kind == 1:
        return f"(not {text})", lambda x, k: -one(x, k)
    if kind in (2, 3):
        name, best, empty = (
            ("always", min, math.inf) if kind == 2 else ("eventually", max, -math.inf)
        )

        def over(x, k):
            end = len(x["a"]) - 1
            return best((one(x, i) for i in range(k + low, min(k + high, end) + 1)), default=empty)

        return f"({name}[{low}:{high}] {text})", over
    other_text, other = random_formula(draw, depth - 1)
    if kind == 4:
        return f"({text} and {other_text})", lambda x, k: min(one(x, k), other(x, k))
    return f"({text} or {other_text})", lambda x, k: max(one(x, k), other(x, k))


@pytest.mark.parametrize("seed", range(50))
def test_a_score_is_the_robustness_by_its_definition(seed):
    draw = np.random.default_rng(seed)
    text, expected = random_formula(draw, 3)
    traces = {name: draw.normal(size=12).round(3).tolist() for name in "ab"}
    signals = {name: name for name in "ab" if re.search(rf"\b{name}\b", text)}
    score, clipped = Requirement(text, signals)(episode(**traces))
    wanted = expected(traces, 0)
    assert not clipped
    if math.isinf(wanted):
        assert score == float(wanted > 0)
    else:
        assert robustness(score) == pytest.approx(wanted, abs=1e-9)


def test_half_is_the_edge_and_scale_is_three_quarters():
    for scale in (0.1, 1.0, 20.0):
        rule = as_score(("stl", "always a > 0", {}, scale))
        assert rule(episode(a=[1.0, 0.0]))[0] == 0.5
        assert rule(episode(a=[scale, 2 * scale]))[0] == 0.75
        assert rule(episode(a=[5.0, -scale]))[0] == 0.25


@pytest.mark.parametrize(
    ("where", "expected"),
    [(1, -2.0), ("a", 3.0), (lambda episode: [9.0, 8.0, 7.0], 7.0)],
    ids=["observation", "info", "function"],
)
def test_where_signals_come_from(where, expected):
    score, _ = Requirement("always x > 0", {"x": where})(episode(a=[5.0, 3.0, 4.0]))
    assert robustness(score) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "where"), [("v", None), ("x", "v"), ("x", "p[1]"), ("x", "q[-1]")]
)
def test_signals_of_dict_observations_and_of_arrays_in_infos(name, where):
    told = episode(q=[[0.0, 5.0], [0.0, 3.0], [0.0, 4.0]])
    observations = tuple({"v": np.array([v]), "p": np.array([[9.0, v]])} for v in (5.0, 3.0, 4.0))
    one = replace(told, observations=observations)
    score, _ = Requirement(f"always {name} > 0", {name: where} if where else {})(one)
    assert robustness(score) == 3.0
    with pytest.raises(UserError, match=r"the keys 'q', and in the observation 'v', 'p'"):
        Requirement("always u > 0")(one)
    with pytest.raises(UserError, match=r"Expected entry 2 of 'p' as the signal 'u', got 2"):
        Requirement("always u > 0", {"u": "p[2]"})(one)
    with pytest.raises(UserError, match="Name an entry, such as"):
        Requirement("always u > 0", {"u": 0})(one)


def test_what_is_not_said_at_the_reset_is_what_the_first_step_says():
    told = episode(a=[9.0, 1.0, 2.0])
    silent = Episode(
        told.rewards, told.observations, told.actions, ({}, *told.infos[1:]), False, True
    )
    assert robustness(Requirement("always a > 0")(silent)[0]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("stl", "always[0:5 a < 1"), "Expected ']' at character 12 of the formula"),
        (("stl", "a > 2²"), "at character 6 of the formula 'a > 2²', got '²'"),
        (("stl", "'a' > 0"), 'at character 1 of the formula "\'a\' > 0", got "\'"'),
        (("stl", "größe > 0"), "got 'ö'. Names have the letters a to z"),
        (("stl", "a > 0 # c"), "at character 7 of the formula 'a > 0 # c', got '#'"),
        (
            ("stl", "a > 0\nand b >"),
            "Expected a variable or a number at character 14 of the formula",
        ),
        (
            ("stl", "-a > 0"),
            "Expected a number at character 2 of the formula '-a > 0', got 'a'. For -x",
        ),
        (("stl", "a.b > 0"), "say where it comes from by signals={'x_y': 'x.y'}"),
        (("stl", "a[0] > 0"), "Expected an operator or the end at character 2"),
        (("stl", "a > s"), "s is a unit of time"),
        (("stl", "ln(a) > 1"), "which rtamt reads as 'ln' and '(a)>(1.0)'"),
        (("stl", "a = 1"), "Expected one formula, got 'a = 1', which rtamt reads as '1.0'"),
        (("stl", "a unless b > 0"), "Give unless a window"),
        (("stl", "time > 0"), "Expected other names than 'time'"),
        (("stl", "always[5:2] a > 0"), "got [5:2] in 'always[5:2] a > 0'"),
        (("stl", "b > 0 and once[0:0.5] a > 0"), "got [0:0.5]"),
        (("stl", "always[-1:5] a > 0"), "got [-1:5]"),
        (("stl", "always[1s:5] a > 0"), "Expected windows from a whole number of steps"),
        (("stl", "always a < 1", {"b": 0}), "whose variables are a; got 'b'"),
        (("stl", "always a < 1", {"a": None}), "signal 'a' to be the number"),
        (("stl", "always a < 1", {"a": True}), "signal 'a' to be the number"),
        (("stl", "always a < 1", {}, 0.0), "scale of an 'stl' score above 0"),
        (("stl", 5), "with a text and a dictionary"),
    ],
)
def test_what_is_refused(given, message, capfd):
    with pytest.raises(UserError, match=re.escape(message)) as told:
        as_score(given)
    assert len(str(told.value)) < 280
    assert capfd.readouterr() == ("", "")


def test_a_negative_value_is_a_difference():
    assert robustness(Requirement("always 0 - a > 0")(episode(a=[-2.0, -3.0]))[0]) == pytest.approx(
        2.0
    )


def test_a_window_beyond_the_end_leaves_a_variable_as_it_is():
    for formula in ("always[0:9] a and eventually[0:9] a", "eventually[0:9] a and always[0:9] a"):
        assert robustness(Requirement(formula)(episode(a=[3.0, 1.0, 2.0]))[0]) == 1.0


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"a": "nowhere"}, r"info\['nowhere'\] at every step as the signal 'a', got the keys 'a'"),
        ({"a": 7}, "entry 7 of an observation as the signal 'a'"),
        ({"a": lambda episode: [1.0]}, "Expected 3 numbers as the signal 'a'"),
        ({"a": lambda episode: 1 / 0}, "Expected a signal 'a', got ZeroDivisionError"),
    ],
)
def test_signals_that_are_missing_or_no_numbers(signals, message):
    with pytest.raises(UserError, match=message):
        Requirement("always a < 1", signals)(episode(a=[1.0, 2.0, 3.0]))


def test_a_signal_of_nan_makes_a_world_invalid():
    with pytest.raises(InvalidWorld, match="the signal 'a' is not finite"):
        Requirement("always a < 1")(episode(a=[1.0, math.nan]))


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        ("always sqrt(a) < 9", "the formula raised ValueError: math domain error"),
        ("1 / (a + 1) > 0", "the formula raised ZeroDivisionError"),
        ("exp(a * a * 999) > 0", "the formula raised OverflowError"),
        ("a * 1e308 * 10 - a * 1e308 * 10 > 0", "its robustness is NaN"),
    ],
)
def test_a_formula_that_cannot_be_computed_makes_a_world_invalid(formula, reason):
    rule = Requirement(formula)
    with pytest.raises(InvalidWorld) as told:
        rule(episode(a=[-1.0, -1.0]))
    assert reason in told.value.reason
    assert 0.0 < rule(episode(a=[1e-300, 1e-300]))[0] < 1.0


def angle_of(env):
    return env.state[2]


@pytest.mark.parametrize("where", [2, angle_of], ids=["observation", "environment"])
def test_an_application_with_a_requirement(where):
    score = ("stl", "always[0:30] (abs(angle) < 0.05)", {"angle": where}, 0.05)
    application = GymnasiumApplication(
        "CartPole-v1",
        agent=Still(),
        agent_id="still",
        parameters={"gravity": (5.0, 15.0)},
        score=score,
        fooling_threshold=0.5,
    )
    (found,) = application.evaluate([[0.0]], [0]).score
    assert 0.0 < found < 0.5
    other = pickle.loads(pickle.dumps(application))
    assert other.evaluate([[0.0]], [0]).score[0] == found
    both = GymnasiumApplication(
        "CartPole-v1",
        agent=Still(),
        agent_id="still",
        parameters={"gravity": (5.0, 15.0)},
        score={"upright": score, "fast": ("stl", "a > 5", {"a": angle_of})},
        fooling_threshold=0.5,
    )
    assert both.evaluate([[0.0]], [0]).infos[0]["requirements"]["upright"] == found


def test_a_report_says_the_formula(tmp_path):
    formula = "always[0:30]\n(abs(angle) < 0.05)"
    application = GymnasiumApplication(
        "CartPole-v1",
        agent=Still(),
        agent_id="still",
        parameters={"gravity": (5.0, 15.0)},
        score=("stl", formula, {"angle": 2}, 0.05),
        fooling_threshold=0.5,
    )
    options = {"budget": 0, "samples": 4, "pictures": False}
    run = attack(application, "random", out=tmp_path / "run", **options)
    text = "always[0:30] (abs(angle) < 0.05), fails where Q ≤ 0.5"
    assert dict(run.rows())["requirement"] == text
