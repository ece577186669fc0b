"""The nominal world, the smallest changes that fail, and how the summary tells of them."""

import numpy as np
import pytest
from toy import Toy

from sada_gym import attack
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.nominal import EPISODES, SEEDS, explore_nominal, most_worlds, seeds_within
from sada_gym.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(Parameter("mass", 0.0, 10.0, "kg"), Parameter("wind", -4.0, 4.0))
NOMINAL = np.array([-0.6, 0.0], np.float32)  # 2 kg, no wind


class World:
    """The agent fails above a mass, or with the wind from the left."""

    def __init__(self, mass=6.5, wind=-3.0):
        self.mass, self.wind, self.count = mass, wind, 0

    def __call__(self, mu):
        mu = np.repeat(mu, SEEDS, axis=0).astype(np.float32)
        mass, wind = SPACE.physical(mu).T
        self.count += len(mu)
        score = np.where((mass > self.mass) | (wind < self.wind), 0.1, 0.9)
        return Evaluations(mu, score, np.arange(len(mu)))


def known(*rows):
    mu = np.array(rows, np.float32).reshape(-1, 2)
    return Evaluations(mu, np.full(len(mu), 0.1), np.arange(len(mu)))


def test_the_smallest_change_of_each_parameter_is_found():
    world = World()
    found = explore_nominal(SPACE, NOMINAL, world, known([0.9, 0.0], [0.5, -0.9]), 0.3)
    assert found.parameters == pytest.approx({"mass": 2.0, "wind": 0.0}, abs=1e-5)
    assert (found.score, found.evaluations, found.fooled) == (pytest.approx(0.9), SEEDS, 0)
    wind, mass = sorted(found.smallest, key=lambda change: change.parameter, reverse=True)
    assert [change.parameter for change in found.smallest] == ["wind", "mass"]  # 3/8 and .45
    assert wind.nominal == pytest.approx(0.0, abs=1e-5)
    assert -3.0 - 4.0 / 2**5 <= wind.value < -3.0
    assert 6.5 < mass.value <= 6.5 + 8.0 / 2**5
    assert found.nearest.parameters == pytest.approx({"mass": 7.5, "wind": -3.6}, abs=1e-5)
    assert found.nearest.change == pytest.approx(0.55)
    assert world.count <= SEEDS * most_worlds(len(SPACE))


def test_what_fails_at_neither_end_is_not_named():
    found = explore_nominal(SPACE, NOMINAL, World(mass=11.0), known(), 0.3)
    assert [change.parameter for change in found.smallest] == ["wind"]
    assert found.nearest is None


def test_an_agent_that_fails_in_the_nominal_world_needs_no_change():
    found = explore_nominal(SPACE, NOMINAL, World(mass=1.0), known(), 0.3)
    assert (found.fooled, found.smallest) == (SEEDS, ())


def test_a_nominal_value_at_the_end_of_the_range_is_moved_one_way_only():
    world = World()
    found = explore_nominal(SPACE, np.array([-1.0, 1.0], np.float32), world, known(), 0.3)
    assert {change.parameter for change in found.smallest} == {"mass", "wind"}
    assert world.count == SEEDS * (1 + 2 + 5 * 2)


def test_the_smallest_change_of_a_whole_number_is_another_number():
    """A world that fails by its seed alone says nothing of the number that it has anyway."""
    space = ParameterSpace(
        Parameter("delay", -0.5, 3.5, whole=True),
        Parameter("light", 0.0, 1.0, choices=("day", "dusk", "night")),
    )
    nominal, played = space.normalised([0.0, 0.1]), []

    def play(mu):
        played.extend(mu.tolist())
        delay, light = space.physical(mu).T
        score = np.where((delay >= 1.5) | (light > 0.9) | (len(played) > 1), 0.1, 0.9)
        return Evaluations(np.asarray(mu, np.float32), score, np.arange(len(mu)))

    found = explore_nominal(space, nominal, play, Evaluations.empty(2), 0.3)
    told = {change.parameter: change.value for change in found.smallest}
    assert told == pytest.approx({"delay": 1.0, "light": 0.5})


class Pole(Toy):
    """The toy with a world in ordinary use."""

    nominal = np.full(3, -0.8, np.float32)


def test_an_attack_tells_of_the_nominal_world_and_of_what_matters(tmp_path):
    result = attack(
        Pole(), "memorise", budget=300, samples=50, out=tmp_path, pictures=False, progress=False
    )
    report = result.result
    assert report.nominal.parameters == pytest.approx(
        Pole().parameters.describe(Pole.nominal), abs=1e-6
    )
    assert {influence.parameter for influence in report.influences} == {*Pole().parameters.names}
    text = str(result)
    assert "what matters " in text
    assert "nearest failure " in text
    assert "as it is (nominal, 1 episode)" in text
    beside = report.nominal.beside_budget
    assert report.nominal.evaluations < beside <= SEEDS * most_worlds(3)
    assert f"{beside} evaluations of the nominal world and around it" in " ".join(text.split())
    again = attack(Pole(), "memorise", budget=300, samples=50, out=tmp_path, resume=True,
                   pictures=False, progress=False)  # fmt: skip
    assert again.result == report


def test_no_world_is_played_around_the_nominal_one_without_a_diagnosis(tmp_path):
    played = []

    class Counted(Pole):
        def evaluate_batch(self, mu, seeds):
            played.extend(seeds)
            return super().evaluate_batch(mu, seeds)

    keywords = {"budget": 300, "samples": 50, "pictures": False, "progress": False, "confirm": 0}
    plain = attack(Counted(), "memorise", out=tmp_path / "plain", diagnose=False, **keywords)
    assert len(played) == 350
    assert plain.result.nominal is None
    assert plain.result.influences
    whole = attack(Counted(), "memorise", out=tmp_path / "whole", **keywords)
    assert (plain.samples.score == whole.samples.score).all()
    assert whole.result.nominal.beside_budget > 0


def test_nothing_is_told_of_a_nominal_world_that_is_unknown(tmp_path):
    report = attack(
        Toy(), "random", budget=200, samples=50, out=tmp_path, pictures=False, progress=False
    ).result
    assert report.nominal is None


@pytest.mark.parametrize(("budget", "episodes"), [(339, 3), (340, EPISODES)])
def test_where_it_is_cheap_the_nominal_world_is_played_often(tmp_path, budget, episodes):
    result = attack(
        Pole(), "random", budget=budget, samples=60, out=tmp_path, pictures=False, progress=False
    )
    found = result.result.nominal
    assert found.evaluations == (episodes if budget == 340 else seeds_within(budget, 3))
    assert found.score == Pole().evaluate([Pole.nominal], [0]).score[0], "its score has no noise"


def test_a_small_budget_pays_for_one_evaluation_a_world():
    assert most_worlds(3) == 37
    assert (seeds_within(444, 3), seeds_within(443, 3)) == (SEEDS, 1)
