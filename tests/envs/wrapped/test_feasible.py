"""Which worlds can exist is declared, and the others are never computed."""

from __future__ import annotations

import pickle
import time

import numpy as np
import pytest

from sada_gym import GymnasiumApplication, attack
from sada_gym.adversaries import make
from sada_gym.envs.wrapped.feasible import Expression, Feasible
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import AdversaryError, UserError
from sada_gym.evaluation.oracle import Oracle
from tests.support.breaking_worlds import Breaking, breaking, uniform

NAMES = ("mass", "wind", "body mass", "road")


@pytest.mark.parametrize(
    ("text", "mass", "wind", "holds"),
    [
        ("mass * wind < 30", 5, 5, True),
        ("mass * wind < 30", 6, 5, False),
        ("0 < wind <= 2 * mass", 1, 2, True),
        ("0 < wind <= 2 * mass", 1, 2.1, False),
        ("not (mass > 1 and wind > 1) or sqrt(mass) == 3", 9, 2, True),
        ("abs(wind) ** 2 + body_mass // 2 % 3 >= -1", 0, 0, True),
        ("road == 'wet' and max(mass, wind) > 3", 4, 0, True),
        ("road != 'wet'", 4, 0, False),
    ],
)
def test_expressions_mean_what_they_say(text, mass, wind, holds):
    values = {"mass": mass, "wind": wind, "body mass": 2.0, "road": "wet"}
    expression = pickle.loads(pickle.dumps(Expression(text, NAMES)))
    assert expression(values) is holds


def test_of_two_names_that_are_spelled_alike_the_exact_one_counts():
    exact = Expression("arm_mass < 2", ("arm_mass", "arm.mass"))
    assert exact({"arm_mass": 0.0, "arm.mass": 4.0})
    assert not exact({"arm_mass": 4.0, "arm.mass": 0.0})
    assert Expression("\N{MICRO SIGN} < 2", ("\N{MICRO SIGN}",))({"\N{MICRO SIGN}": 1.0})
    with pytest.raises(UserError, match=r"one parameter that arm_mass .* got arm-mass and arm\.ma"):
        Expression("arm_mass < 2", ("arm-mass", "arm.mass"))


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__.__mro__",
        "mass.real < 1",
        "[mass for mass in (1, 2)]",
        "(lambda: 1)() < 2",
        "open('x') == 1",
        "mass if wind else 1",
        "f'{mass}' == '1'",
        "{'a': 1} == 1",
        "mass[0] < 1",
        "mass is 1",
        "(x := 3) < 4",
        "max(*wind) < 1",
        "max(mass, key=abs) < 1",
        "mass < None",
        "mass < 1j",
        "mass + wind",
        "mass <",
        "",
        "mass = 3",
        "(" * 400 + "mass" + ")" * 400 + " < 1",
        "mass < 1 or " * 200 + "mass < 1",
        "gravity < 3",
        "\x00",
    ],
)
def test_all_else_is_refused_with_a_sentence(text):
    with pytest.raises(UserError, match="Expected"):
        Expression(text, NAMES)


def test_huge_powers_end_at_once():
    began = time.process_time()
    with pytest.raises(UserError, match="OverflowError"):
        Feasible.of("9 ** 9 ** 9 ** 9 < mass", NAMES)({"mass": 1, "wind": 0})
    assert time.process_time() - began < 1.0


def allowed(values):
    return values["mass"] < 1.5 + values["wind"]


@pytest.mark.parametrize(
    "feasible", [allowed, "mass < 1.5 + wind", ["mass < 1.5 + wind", "wind<9"]]
)
def test_worlds_that_cannot_exist_are_never_computed(feasible):
    made = []

    class Counted(Breaking):
        def reset(self, **kwargs):
            made.append((self.mass, self.wind))
            return super().reset(**kwargs)

    application = GymnasiumApplication(
        Counted,
        agent=lambda seen: [0.0],
        agent_id="still",
        parameters={"mass": (0.5, 2.0), "wind": (-0.5, 0.5)},
        score=("return", -5.0, 0.0),
        fooling_threshold=0.5,
        feasible=feasible,
        max_steps=9,
    )
    made.clear()
    mu = uniform(60)
    outcomes = application.evaluate(mu, range(60))
    physical = application.parameters.physical(mu)
    can = physical[:, 0] < 1.5 + physical[:, 1]
    assert 0 < can.sum() < 60
    assert [*outcomes.invalid] == np.flatnonzero(~can).tolist()
    assert (outcomes.score[~can] == 1.0).all()
    assert not outcomes.fooled[~can].any()
    assert made
    assert all(mass < 1.5 + wind for mass, wind in made)
    assert {frozenset(info) for info in outcomes.infos} == {frozenset(outcomes.infos[0])}


@pytest.mark.parametrize("adversary", ["random", "level-set", "gaussian", "cross-entropy"])
def test_queries_and_samples_stay_in_the_region(tmp_path, adversary):
    application = breaking("none", feasible="mass < 1 + wind")
    result = attack(
        application, adversary, out=tmp_path, budget=60, samples=30, pictures=False, progress=False
    )
    values = application.parameters.physical(result.samples.mu)
    assert (values[:, 0] < 1.0 + values[:, 1]).all()
    assert not result.samples.invalid.any()
    asked = application.parameters.physical(result.queries.mu)
    if adversary != "cross-entropy":  # which mutates what it drew
        share = (asked[:, 0] < 1.0 + asked[:, 1]).mean() if len(asked) else 1.0
        assert share == 1.0


def test_an_adversary_that_asks_elsewhere_sees_an_invalid_world():
    application = breaking("none", feasible="mass < 1")
    with Oracle(application, budget=2) as oracle:
        assert oracle(np.array([[1, 0], [-1, 0]], np.float32))[0] == 1.0
        assert oracle.invalid == {0: "it lies outside the region that feasible= allows"}
        assert oracle.permits(uniform(5)).dtype == np.bool_
    with Oracle(breaking("none"), budget=2) as oracle:
        assert oracle.permits(uniform(5)).all()


def test_infeasible_queries_are_no_reason_to_end_a_run():
    application = breaking("none", feasible="mass < 0.6")
    with Oracle(application, budget=100) as oracle:
        oracle(uniform(100))
        assert len(oracle.invalid) > 80


def test_a_region_that_is_too_small_is_told_at_once():
    with pytest.raises(UserError, match=r"\['mass < 0.5'\] to hold in a thousandth .*, got 0 of"):
        breaking("none", feasible="mass < 0.5")


def test_an_adversary_that_samples_elsewhere_ends_with_a_sentence(tmp_path):
    class Stubborn(type(make("random", dimension=2))):
        name = "stubborn"

        def sample(self, n):
            return np.ones((n, 2), np.float32)

    with pytest.raises(AdversaryError, match=r"5 mu in the region that feasible= allows, got 0 of"):
        attack(
            breaking("none", feasible="mass < 1"),
            Stubborn,
            out=tmp_path,
            budget=0,
            samples=5,
            progress=False,
        )


@pytest.mark.parametrize(
    ("feasible", "message"),
    [
        (3, "an expression such as .*, got 3"),
        (["mass < 1", 3], "an expression such as .*, got 3"),
        (lambda values: None, "True or False from feasible='<lambda>', got None"),
        (lambda values: values["gravity"] < 1, "to judge {'mass': .*KeyError: 'gravity'"),
        ("1 / (mass - mass) < 1", "ZeroDivisionError"),
    ],
)
def test_bad_conditions_get_a_sentence(feasible, message):
    with pytest.raises(UserError, match=message):
        breaking("none", feasible=feasible)


def test_a_corner_that_cannot_exist_is_not_begun():
    with pytest.raises(UserError, match="its reset"):
        breaking("raises", where="reset", parameters={"mass": (0.5, 1.9), "wind": (-1, 1)})
    breaking(
        "raises",
        where="reset",
        parameters={"mass": (0.5, 1.9), "wind": (-1, 1)},
        feasible="mass < 1.8",
    )


def test_a_file_says_it_in_expressions(tmp_path):
    file = tmp_path / "mine.toml"
    text = """
environment = "tests.support.breaking_worlds:Breaking-v0"
agent = "tests.support.breaking_worlds:push"
agent_id = "push"
score = ["return", -5.0, 0.0]
fooling_threshold = 0.5
feasible = {feasible}
valid = "tests.support.breaking_worlds:light"
on_error = "fooled"
timeout = 10
[parameters]
mass = [0.5, 2.0]
wind = [-0.5, 0.5]
"""
    file.write_text(text.replace("{feasible}", '["mass < 1.5", "wind < mass"]'))
    application = read_application(file)
    assert application.settings["feasible"] == ["mass < 1.5", "wind < mass"]
    assert application.settings["on_error"] == "fooled"
    assert application.settings["timeout"] == 10.0
    mu = uniform(40)
    mass = application.parameters.physical(mu)[:, 0]
    outcomes = application.evaluate(mu, range(40))
    assert [*outcomes.invalid] == np.flatnonzero(mass >= 1.5).tolist()
    assert (outcomes.score[(mass > 1.2) & (mass < 1.5)] == 0.0).all()  # too heavy, says `light`
    for bad in ('"gravity < 3"', "3", "[3]"):
        file.write_text(text.replace("{feasible}", bad))
        with pytest.raises(UserError, match="feasible"):
            read_application(file)
