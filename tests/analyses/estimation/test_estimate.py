"""`estimate` of runs and applications: densities, invalid worlds, stops, workers, and its words."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t, norm
from toy import Toy
from typer.testing import CliRunner

import sada_gym
from sada_gym import Application, Parameter, ParameterSpace, Scored, attack, load_run
from sada_gym.analyses.estimation.estimate import _shares, estimate
from sada_gym.analyses.estimation.use import JointUse
from sada_gym.cli import app
from sada_gym.measures.likelihood import FailureEstimate, odds
from sada_gym.parameters import all_can_exist

NORMAL = {"normal": [0.0, 30.0]}
TOY = {f"angle{i}_deg": NORMAL for i in range(2)}


class Slope(Application):
    """Fails where the sum of two parameters is above a limit; some worlds are invalid."""

    name = "Slope"
    fooling_threshold = 0.5
    sample_size = 20
    parameters = ParameterSpace(
        Parameter("wind", -4.0, 4.0),
        Parameter("road", 0.0, 3.0, choices=("dry", "wet", "ice")),
        Parameter("cars", -0.5, 9.5, whole=True),
    )

    def __init__(self, limit=4.0, *, invalid_above=np.inf, permits=None, agent_id=""):
        self.limit, self.invalid_above, self.agent_id = limit, invalid_above, agent_id
        if permits is not None:
            self.permits = permits

    @property
    def fingerprint(self):
        return self.agent_id

    def load(self, mu):
        wind, road, cars = self.parameters.physical(mu).T
        return wind + np.minimum(road.astype(int), 2) + (np.floor(cars + 0.5) > 7.0)

    def evaluate_batch(self, mu, seeds):
        score = np.clip(0.5 + 0.1 * (self.limit - self.load(mu)), 0.0, 1.0)
        wind = self.parameters.physical(mu)[:, 0]
        extras = [{"invalid": "a gust"} if w > self.invalid_above else {} for w in wind]
        return Scored(score, extras)


DENSITIES = {
    "wind": {"normal": [0.0, 1.0]},
    "road": {"values": ["dry", "wet", "ice"], "weights": [90, 9, 1]},
    "cars": {"uniform": [0.0, 9.0]},
}


def truth(application, worlds=400_000):
    from sada_gym.densities import Density, WorldDensity

    densities = {name: Density(data) for name, data in DENSITIES.items()}
    density = WorldDensity(application.parameters, densities)
    mu = density.sample(worlds, np.random.default_rng(5))
    wind = application.parameters.physical(mu)[:, 0]
    keep = application.permits(mu) & (wind <= application.invalid_above)
    return (application.load(mu[keep]) >= application.limit).mean()


def mild(mu):
    return mu[:, 0] < 0.3


@pytest.mark.long
@pytest.mark.parametrize(
    "application", [Slope(3.2), Slope(1.8, invalid_above=2.0), Slope(2.0, permits=mild)]
)
def test_choices_whole_numbers_invalid_worlds_and_feasible_regions(application):
    found = estimate(application, budget=600, density=DENSITIES)
    low, high = found.interval
    assert low <= truth(application) <= high
    assert found.queries == 600
    assert found.refused is None


@pytest.mark.long
def test_a_joint_density_may_correlate_parameters():
    both = multivariate_normal([0.0, 1.5, 4.0], [[1.0, 0.5, 0.0], [0.5, 0.4, 0.0], [0, 0, 1.0]])
    application = Slope(4.4)
    values = both.rvs(400_000, random_state=1)
    mu = application.parameters.normalised(values)
    mu = mu[(np.abs(mu) <= 1.0).all(axis=1)]
    found = estimate(application, budget=600, density=both)
    low, high = found.interval
    assert low <= (application.load(mu) >= 4.4).mean() <= high
    assert found.held == pytest.approx(len(mu) / len(values), rel=0.02)


@pytest.mark.long
def test_a_stopped_estimate_goes_on_and_workers_change_no_bit(tmp_path):
    whole = estimate(Toy(2), budget=320, density=TOY)
    store = tmp_path / "scores.sqlite"

    def stop(done, total, cached):
        if done > 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        estimate(Toy(2), budget=320, density=TOY, store=store, on_scores=stop)
    seen = []
    again = estimate(
        Toy(2, log=str(tmp_path / "log")),
        budget=320, density=TOY, store=store, workers=2,
        on_scores=lambda *counts: seen.append(counts),
    )  # fmt: skip
    assert again == whole
    assert seen[-1][:2] == (320, 320)
    assert seen[-1][2] > 100  # from the store
    assert len((tmp_path / "log").read_text().splitlines()) == 320 - seen[-1][2]


@pytest.mark.long
def test_a_run_keeps_its_estimate_and_tells_it(tmp_path):
    run = attack(
        "SADA-Analytic-v0", budget=200, samples=40, env_kwargs={"volume": 0.1}, pictures=False,
        out=tmp_path / "run",
    )  # fmt: skip
    assert run.estimate is None
    densities = {"x0": {"normal": [0.0, 0.3]}, "x1": {"normal": [0.0, 0.3]}}
    found = sada_gym.estimate(run, budget=300, density=densities)
    assert load_run(run.folder).estimate == found
    told = load_run(run.folder).result.in_use
    assert (told.probability, told.interval_95) == (found.probability, found.interval)
    assert told.density == found.density == densities
    assert found.sentence in str(run)
    assert "based on" in str(run)
    if found.shares:
        assert sum(share.share for share in found.shares) == pytest.approx(1.0)
    page = sada_gym.report(run).read_text(encoding="utf-8")
    first, _, _ = page.partition("What to do next")
    assert found.sentence in first
    # by the command line, to the bit
    given = [f'{name}={{"normal": [0.0, 0.3]}}' for name in densities]
    words = ["estimate", str(run.folder), "--budget", "300", "--json", "--density", given[0],
             "--density", given[1]]  # fmt: skip
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    assert FailureEstimate.model_validate_json(result.stdout) == found


@pytest.mark.long
def test_the_ratio_of_two_agents_in_common_worlds_is_known():
    weak, strong = Slope(2.6), Slope(3.6)
    found = estimate(weak, beside=strong, budget=600, density=DENSITIES)
    true = truth(weak) / truth(strong)
    low, high = found.beside.ratio_interval
    assert low <= true <= high
    assert found.beside.ratio == pytest.approx(true, rel=0.35)
    assert high / low < (found.interval[1] / found.interval[0]) ** 2  # common worlds help
    assert found.queries == 1_200
    assert found.interval[0] <= truth(weak) <= found.interval[1]
    assert found.beside.interval[0] <= truth(strong) <= found.beside.interval[1]
    assert "times as often" in dict(found.rows())["compared"]


@pytest.mark.long
def test_the_ratio_of_an_agent_to_itself_is_one_and_an_agent_needs_the_same_ranges():
    same = estimate(Slope(2.6), beside=Slope(2.6), budget=400, density=DENSITIES)
    assert same.beside.ratio == 1.0
    assert same.beside.ratio_interval == pytest.approx((1.0, 1.0), abs=0.1)
    with pytest.raises(ValueError, match="same parameters and ranges"):
        estimate(Slope(2.6), beside=Toy(2), budget=400, density=DENSITIES)
    with pytest.raises(ValueError, match="which only an id can take"):
        estimate(Slope(2.6), beside="new.zip", budget=400, density=DENSITIES)


def test_two_agents_share_a_store_from_which_a_stopped_comparison_goes_on(tmp_path):
    def compared(**given):
        two = Slope(1.6, agent_id="one"), Slope(2.0, agent_id="two")
        return estimate(two[0], beside=two[1], budget=60, density=DENSITIES, **given)

    def stop(done, total, cached):
        raise KeyboardInterrupt

    store, seen = tmp_path / "scores.sqlite", []
    with pytest.raises(KeyboardInterrupt):
        compared(store=store, on_scores=stop)
    again = compared(store=store, on_scores=lambda *counts: seen.append(counts))
    assert again == compared()
    assert seen[0][2] > 0
    compared(store=store, on_scores=lambda *counts: seen.append(counts))
    assert seen[-1] == (120, 120, 120)


def test_invalid_worlds_of_ordinary_use_alone_are_judged():
    # 4.6 % of ordinary worlds are invalid, and a third of those that are stretched
    class Both(Slope):
        def evaluate_batch(self, mu, seeds):
            scored = super().evaluate_batch(mu, seeds)
            wind = self.parameters.physical(mu)[:, 0]
            return Scored(scored.score, [{"invalid": "a gust"} if abs(w) > 2 else {} for w in wind])

    found = estimate(Both(2.5), budget=400, density=DENSITIES)
    assert found.plain < 110  # of valid worlds
    assert found.drawn < 220
    assert found.unseen == 1.0 - 0.05 ** (1.0 / found.plain)
    with pytest.raises(ValueError, match=r"at most 20% invalid worlds, got .* a gust"):
        estimate(Slope(2.5, invalid_above=-0.4), budget=400, density=DENSITIES)


class Given:
    """A joint density of three parameters, whose methods a test changes."""

    normal = multivariate_normal([0.0] * 3, np.diag([900.0, 25.0, 1.0]))

    def __init__(self, **changed):
        self.rvs, self.logpdf = self.normal.rvs, self.normal.logpdf
        vars(self).update(changed)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"logpdf": lambda x: Given.normal.logpdf(x) + 5.0}, "integral is about 1.5e"),
        ({"logpdf": lambda x: Given.normal.logpdf(x) - 0.3}, "integral is about 0.7"),
        ({"logpdf": lambda x: Given.normal.logpdf(x / 2.0) - np.log(8.0)}, "density.rvs draws"),
        ({"logpdf": lambda x: 0.0}, r"shape \([0-9]+,\), got \(\)"),
        ({"logpdf": lambda x: np.zeros((len(x), 2))}, r"got \([0-9]+, 2\). Return a number"),
        ({"logpdf": lambda x: x @ np.eye(2)}, "Expected density to have rvs.* got ValueError"),
        ({"rvs": lambda size: np.zeros((size, 3))}, "Expected density to have rvs.* got TypeError"),
    ],
)
def test_a_density_that_does_not_fit_its_draws_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        estimate(Toy(3), budget=20, density=Given(**changed))


def test_a_density_that_fits_its_draws_is_taken_whatever_its_units():
    heavy = multivariate_t([0.0, 0.0], [[9.0, 3.0], [3.0, 4.0]], df=3)
    found = estimate(Toy(2), budget=20, density=heavy)
    numbers = {"loc": [0.0, 0.0], "shape": [[9.0, 3.0], [3.0, 4.0]], "df": 3}
    assert found.density == {"joint": {"kind": "multivariate_t_frozen", **numbers}}
    space = ParameterSpace(Parameter("mass", 0.0, 2e9), Parameter("slope", -0.1, 0.1))
    mean, sd, rng = np.array([1e9, 0.0]), np.array([1e8, 0.01]), np.random.default_rng(0)
    density = Given(
        rvs=lambda size, random_state: random_state.normal(mean, sd, (size, 2)),
        logpdf=lambda x: norm.logpdf(x, mean, sd).sum(axis=1),
    )
    use = JointUse(space, density, all_can_exist, rng)
    assert use.sample(20_000, rng)[:, 1].std() == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(
    ("given", "message"),
    [({"per": 0}, "per of at least 1"), ({"unit": "a\nb"}, "unit in one line")],
)
def test_bad_words_of_the_use_are_found_before_the_budget_is_spent(given, message):
    with pytest.raises(ValueError, match=message):
        estimate(Toy(2), budget=20, density=TOY, on_scores=lambda *_: 1 / 0, **given)


def test_an_agent_that_never_failed_gives_a_ratio_without_a_bound():
    found = estimate(Slope(1.0), beside=Slope(99.0), budget=100, density=DENSITIES)
    low, high = found.beside.ratio_interval
    assert (found.beside.ratio, high) == (None, None)
    assert low > 1.0
    assert "times or more) than" in found.beside.sentence


def test_agents_that_both_never_failed_are_not_compared():
    found = estimate(Slope(99.0), beside=Slope(99.0), budget=20, density=DENSITIES)
    assert found.beside.sentence.endswith(" did not fail in the same worlds either")


def test_the_refusal_of_the_other_agent_is_told():
    found = estimate(Slope(1.0), beside=Slope(1.2), budget=100, density=DENSITIES).beside
    refused = found.model_copy(update={"refused": "too few failures"})
    assert refused.sentence == f"{found.sentence}. Do not rely on it: too few failures"


def test_a_missing_folder_is_told():
    result = CliRunner().invoke(app, ["estimate", "run1"], env={"COLUMNS": "300"})
    assert result.exit_code == 2
    assert "no such file or folder" in result.output


def test_failures_whose_weights_underflowed_have_no_shares():
    run = SimpleNamespace(diagnosis=SimpleNamespace(weaknesses=["any"]))
    found = SimpleNamespace(failed=np.ones(3, bool), terms=np.zeros(3))
    assert _shares(run, None, np.zeros((3, 2)), found) == ()


def test_what_draws_are_worth_is_told_of_rare_failures_alone():
    assert "80 of 1,100 fresh draws failed, as informative as 60 failures" in record().basis
    assert "worth" not in record(probability=0.95).basis
    assert "worth" not in record(plain=1_100).basis


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "Expected a density of ordinary use, got none: Toy does not say"),
        ({"density": {"angle9": NORMAL}}, "Expected densities of angle0_deg, .* got one of"),
        ({"density": 3}, "Expected density to have rvs"),
        ({"density": {"angle0_deg": 3}}, "Expected a density as .* got 3"),
        ({"density": {"angle0_deg": {}}}, "Expected a density as .* got {}"),
        ({"density": multivariate_normal([0.0], [[1.0]])}, "finite draws of 3 parameters"),
        ({"density": multivariate_normal([1e3] * 3)}, "a thousandth at least of the density"),
        ({"budget": 5}, "budget"),
        ({"seed": -1}, "seed"),
    ],
)
def test_what_tells_no_density_gets_a_sentence(given, message):
    with pytest.raises(ValueError, match=message):
        estimate(Toy(3), **given)


def test_what_is_neither_run_nor_application_gets_a_sentence(tmp_path):
    with pytest.raises(TypeError, match="Expected a run, an Application"):
        estimate(3)
    with pytest.raises(ValueError, match="Expected a folder that `sada-gym attack` wrote"):
        estimate(tmp_path)


@pytest.mark.parametrize(
    ("probability", "text"),
    [(1.064e-4, "1 of 9,400"), (1.0, "100 %"), (0.02, "1 of 50"), (0.0, "0"), (0.25, "25 %")],
)
def test_odds_are_written_as_people_say_them(probability, text):
    assert odds(probability) == text


def record(**given):
    fields = {
        "probability": 1e-4,
        "interval": (5e-5, 2.4e-4),
        "queries": 2_000,
        "method": "plain draws",
        "refused": None,
        "held": 1.0,
        "drawn": 1_100,
        "failures": 80,
        "plain": 550,
        "plain_failures": 0,
        "effective": 60.0,
        "unseen": 5e-3,
        "density": {},
        "seed": 0,
    }
    return FailureEstimate(**{**fields, **given})


def test_the_line_for_a_safety_case():
    assert record().sentence == (
        "fails in 1 of 10,000 ordinary worlds (95 %: 1 of 20,000 to 1 of 4,200)"
    )
    nothing = record(probability=0.0, failures=0, interval=(0.0, 3.4e-3))
    assert nothing.sentence == "no failure in 1,100 worlds: below 1 of 290 with 95 %"
    often = record(probability=0.9, interval=(0.8, 0.95), unit="flights")
    assert dict(often.rows())["in use"] == "of 1,000 flights 900 fail (95 %: 800 to 950)"
    assert dict(record(refused="too few").rows())["in ordinary use"].endswith("it: too few")


def test_failures_are_told_by_use():
    rows = dict(record(per=1_000, unit="flights", to_halve=6_000).rows())
    assert rows["in use"] == (
        "of 1,000 flights 0.1 fail (95 %: 0.05 to 0.24), one failure in 10,000 flights"
    )
    assert rows["to halve this interval"] == "about 6,000 more queries"
    assert "in use" not in dict(record().rows())
    nothing = record(probability=0.0, interval=(0.0, 3.4e-3), unit="trips")  # weights underflow
    assert dict(nothing.rows())["in use"] == "of 1,000 trips fewer than 3.4 fail (95 %)"


def test_the_command_tells_what_it_would_take_and_the_use(tmp_path):
    words = ["estimate", "SADA-Analytic-v0", "--budget", "60", "--unit", "trips", "--per", "500"]
    density = ["--density", 'x0={"normal": [0.0, 0.3]}']
    result = CliRunner().invoke(app, [*words, *density], env={"COLUMNS": "300"})
    assert result.exit_code == 0, result.output
    assert "in use: of 500 trips" in result.stdout
    assert re.search("to halve this interval: about [0-9]+ more queries, ", result.stdout)
