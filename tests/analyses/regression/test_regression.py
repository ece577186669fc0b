"""From a run to a suite, and from a suite to a decision."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from junitparser import Failure, JUnitXml, Skipped
from toy import Toy

from sada_gym import attack, make_application
from sada_gym.analyses.ordinary import ORDINARY_WORLDS, ordinary_worlds
from sada_gym.analyses.regression.export import MOST_IN_GROUP, export
from sada_gym.analyses.regression.junit import junit, markdown
from sada_gym.analyses.regression.regress import regress
from sada_gym.analyses.regression.suite import read_suite
from sada_gym.densities import Density, WorldDensity
from sada_gym.errors import FileError, UserError
from sada_gym.measures.diagnosis.grouping import NO_WEAKNESS
from sada_gym.measures.diagnosis.record import read_diagnosis
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.measures.groups import match, neighbourhoods, places, words
from sada_gym.parameters import Parameter, ParameterSpace
from sada_gym.run.folder import read_samples

OLD = 0.1


def run(folder: Path, environment=None, **keywords) -> Path:
    given = {"budget": 0, "samples": 400, "seed": 0, "pictures": False, **keywords}
    environment = Toy(2, offset=OLD) if environment is None else environment
    return attack(environment, given.pop("adversary", "random"), out=folder, **given).folder


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    """Return a suite of a toy that an offset makes better or worse."""
    folder = tmp_path_factory.mktemp("regression")
    attacked = run(folder / "a run")
    return export(attacked, folder / "a suite", application=Toy(2, offset=OLD)).path


def test_a_suite_holds_confirmed_failures_and_as_many_passes_near_them(toy):
    path, suite = read_suite(toy.parent)
    assert path == toy
    toy_ = Toy(2, offset=OLD)
    failures = [case for case in suite.test_cases if case.objective == "failure"]
    controls = [case for case in suite.test_cases if case.objective == "control"]
    assert len(failures) == len(controls) > 5
    assert {case.id for case in controls} == {case.id.replace("F", "C") for case in failures}
    seeds = [seed for case in suite.test_cases for seed in case.seeds]
    samples = read_samples(toy.parent.parent / "a run" / "samples.npz")
    assert not {*seeds} & {*samples.seed.tolist()}  # fresh ones
    assert len({*seeds}) == len(seeds) == 3 * len(suite.test_cases)
    for case in suite.test_cases:
        outcomes = toy_.evaluate([case.mu] * 3, list(case.seeds))
        assert outcomes.fooled.sum() == case.fooled_seeds
        assert case.expected_result == ("fail" if case.fooled_seeds >= 2 else "pass")
        assert case.expected_result == ("fail" if case in failures else "pass")
        assert case.concrete_scenario == toy_.parameters.describe(np.float32(case.mu))
    assert max(np.bincount([case.group for case in failures])) <= MOST_IN_GROUP
    assert "°" in suite.groups[0]


@pytest.mark.parametrize(
    ("offset", "change", "exit_code"),
    [(OLD, "still fails", 0), (OLD + 0.2, "fixed", 0), (OLD - 0.1, "new failure", 1)],
)
def test_unchanged_fixed_and_worse_agents(toy, offset, change, exit_code):
    result = regress(toy, Toy(2, offset=offset))
    counts = result.counts()
    assert result.exit_code == exit_code
    assert counts[change] > 5
    assert sum(counts.values()) == len(result.worlds)
    if offset == OLD:
        assert {*counts} == {"still fails", "still passes"}
        assert "same agent" in result.decision.reason
        assert not result.differences
    else:
        assert any("offset was 0.1 and is" in told for told in result.differences)


def test_one_broken_world_is_inconclusive(toy, tmp_path):
    content = json.loads(toy.read_text())
    failing = next(case for case in content["test_cases"] if case["objective"] == "failure")
    failing["expected_result"] = "pass"
    edited = tmp_path / "edited.json"
    edited.write_text(json.dumps(content))
    result = regress(edited, Toy(2, offset=OLD))
    assert result.exit_code == 3
    assert result.counts()["regressed"] == 1
    assert re.search("at least [0-9]+ more worlds", result.decision.reason)
    assert result.ordinary.status == "passed"


def test_a_suite_of_one_world_with_tags_for_its_name(toy, tmp_path):
    content = json.loads(toy.read_text())
    (case,) = content["test_cases"] = content["test_cases"][:1]
    content["ordinary_cases"] = []
    case.update(id="<script>alert(1)</script>", expected_result="pass")
    edited = tmp_path / "one.json"
    edited.write_text(json.dumps(content))
    result = regress(edited, Toy(2, offset=OLD))
    assert result.exit_code == 3
    (suite,) = JUnitXml.fromstring(junit(result))
    (world,) = suite
    assert [type(broken) for broken in world.result] == [Failure]
    assert "<script>" not in markdown(result)


def test_a_baseline_replaces_what_the_suite_expects(toy):
    better, worse = Toy(2, offset=OLD + 0.2), Toy(2, offset=OLD - 0.05)
    result = regress(toy, worse, baseline=better)
    assert result.counts()["regressed"] > 5
    assert result.exit_code == 1
    reverse = regress(toy, better, baseline=worse)
    assert reverse.decision.fixed == result.decision.broken
    assert reverse.exit_code == 0
    again = regress(toy, better, baseline=Toy(2, offset=OLD + 0.2), margin=0.01)
    assert again.exit_code == 0
    assert "same agent" in again.decision.reason


def test_scores_do_not_depend_on_workers_and_a_store_keeps_them(toy, tmp_path):
    store = tmp_path / "scores.sqlite"
    new = Toy(2, offset=OLD + 0.05)
    first = regress(toy, new, workers=2, store=store)
    seen: list[tuple[int, ...]] = []
    second = regress(toy, new, store=store, on_scores=lambda *counts: seen.append(counts))
    assert first == second
    assert seen[-1][0] == seen[-1][1] == seen[-1][2]
    assert seen[-1][0] == sum(len(world.scores) for world in first.worlds)


def test_a_range_that_moved_keeps_physical_values_and_is_told(toy):
    class Narrow(Toy):
        def __init__(self):
            super().__init__(2, offset=OLD)
            names = self.parameters.names
            self.parameters = ParameterSpace(
                *(Parameter(name, -90.0, 60.0, "deg") for name in names)
            )

    result = regress(toy, Narrow())
    assert any("outside the range of angle0_deg" in told for told in result.differences)
    with pytest.raises(UserError, match="has besides angle2_deg"):
        regress(toy, Toy(3, offset=OLD))


def test_ordinary_worlds_stand_beside_failures_and_an_old_suite_has_none(toy, tmp_path):
    _, suite = read_suite(toy)
    cases = suite.ordinary_cases
    assert len(cases) == ORDINARY_WORLDS
    fooled = Toy(2, offset=OLD).evaluate(
        [case.mu for case in cases], [seed for case in cases for seed in case.seeds]
    ).fooled  # fmt: skip
    assert [case.expected_result == "fail" for case in cases] == fooled.tolist()
    assert not {case.seeds for case in cases} & {case.seeds[:1] for case in suite.test_cases}
    result = regress(toy, Toy(2, offset=OLD - 0.1))
    assert result.ordinary.worlds == ORDINARY_WORLDS
    assert result.ordinary.broken > 8
    assert "In ordinary worlds: " in result.decision.reason
    content = json.loads(toy.read_text())
    del content["ordinary_cases"], content["unlucky_controls"]
    (tmp_path / "suite.json").write_text(json.dumps({**content, "version": 1}))
    old = regress(tmp_path, Toy(2, offset=OLD - 0.1))
    assert old.ordinary is None
    assert old.exit_code == 1
    assert "holds no ordinary worlds" in old.decision.reason


@pytest.mark.parametrize(("most", "exit_code"), [(0.9, 0), (1e-4, 1)])
def test_a_gate_on_the_probability_estimates_it(toy, most, exit_code):
    application = Toy(2, offset=OLD)
    density = {name: Density({"normal": [0.0, 60.0]}) for name in application.parameters.names}
    application.density = WorldDensity(application.parameters, density)
    result = regress(toy, application, max_probability=most, budget=100)
    assert result.exit_code == exit_code
    assert result.likely.queries == 100
    assert "In ordinary use: fails in " in result.decision.reason


def test_a_gate_on_the_probability_needs_a_density_and_a_probability(toy):
    with pytest.raises(UserError, match="Expected a density of ordinary use"):
        regress(toy, Toy(2, offset=OLD), max_probability=0.1)
    with pytest.raises(UserError, match="Expected max_probability above 0"):
        regress(toy, Toy(2, offset=OLD), max_probability=2)


def test_ordinary_worlds_follow_the_density_and_the_feasible_region():
    application = Toy(2)
    space = application.parameters
    density = {name: Density({"normal": [0.0, 9.0]}) for name in space.names}
    application.density = WorldDensity(space, density)
    application.permits = lambda mu: mu[:, 0] > 0.0
    mu = ordinary_worlds(application, 500, 0)
    assert mu[:, 0].min() > 0.0
    assert np.std(space.physical(mu)[:, 1]) == pytest.approx(9.0, rel=0.1)


def test_an_older_package_is_told(toy, tmp_path):
    content = json.loads(toy.read_text())
    content["test_item"]["packages"] |= {"numpy": "1.0", "no-such-package": "2"}
    (tmp_path / "suite.json").write_text(json.dumps(content))
    told = regress(tmp_path, Toy(2, offset=OLD)).differences
    assert told[0].startswith("numpy was 1.0 and is ")
    assert told[1] == "no-such-package was 2 and is not installed"


def test_junit_and_markdown_say_what_broke(toy, tmp_path):
    content = json.loads(toy.read_text())
    content["groups"][0] = "<script>alert(1)</script> & | `x`"
    (tmp_path / "s.json").write_text(json.dumps(content))
    result = regress(tmp_path / "s.json", Toy(2, offset=OLD - 0.1))
    counts = result.counts()
    (suite,) = JUnitXml.fromstring(junit(result))
    cases = [*suite]
    kinds = [type(told) for case in cases for told in case.result]
    assert len(cases) == len(result.worlds) == suite.tests
    assert kinds.count(Failure) == suite.failures == counts["new failure"]
    assert kinds.count(Skipped) == suite.skipped == counts["still fails"]
    assert any("<script>" in case.name for case in cases)
    text = markdown(result)
    assert "<script>" not in text
    assert "fails" in text.splitlines()[0]
    assert text.count("| new failure |") > 20


def test_runs_of_one_agent_make_one_suite_and_others_are_refused(tmp_path):
    first, second = run(tmp_path / "1"), run(tmp_path / "2", seed=1)
    exported = export([first, second], tmp_path / "s", application=Toy(2, offset=OLD), confirm=0)
    assert len(exported.suite.sources) == 2
    known = {*read_samples(first / "samples.npz").seed, *read_samples(second / "samples.npz").seed}
    assert known & {seed for case in exported.suite.test_cases for seed in case.seeds}
    other = run(tmp_path / "3", Toy(2, offset=0.15))
    with pytest.raises(UserError, match="Export them one by one"):
        export([first, other], tmp_path / "s", application=Toy(2, offset=OLD))


def test_an_edited_suite_is_not_overwritten(tmp_path):
    folder, suite = run(tmp_path / "run"), tmp_path / "a suite" / "s.json"
    again = {"application": Toy(2, offset=OLD), "confirm": 1}
    content = export(folder, suite, **again).path.read_text()
    assert export(folder, suite, **again).path.read_text() == content
    edited = content.replace('"expected_result": "fail"', '"expected_result": "pass"', 1)
    suite.write_text(edited)
    with pytest.raises(FileError, match="may have been edited"):
        export(folder, suite, **again)
    assert suite.read_text() == edited


def test_the_groups_of_a_suite_are_the_weaknesses_of_the_diagnosis(tmp_path):
    environment = make_application("SADA-Analytic-v0", dimension=4, regions=1, volume=0.2)
    folder = run(
        tmp_path / "run",
        "SADA-Analytic-v0",
        env_kwargs={"dimension": 4, "regions": 1, "volume": 0.2},
    )
    weaknesses = [weakness.text for weakness in read_diagnosis(folder).weaknesses]
    suite = export(folder, tmp_path / "suite").suite
    assert set(suite.groups) <= {*weaknesses, NO_WEAKNESS}
    assert suite.groups[0] == weaknesses[0]
    for case in suite.test_cases:
        if case.objective == "failure" and case.group == 1:
            first = read_diagnosis(folder).weaknesses[0].conditions
            assert holds(first, environment.parameters, [case.mu]).all()


def test_training_queries_count_too(tmp_path):
    folder = run(tmp_path / "run", adversary="gaussian", budget=200, samples=1)
    exported = export(folder, tmp_path / "s.json", application=Toy(2, offset=OLD))
    assert exported.path == tmp_path / "s.json"
    assert len(exported.suite.test_cases) > 6


def test_a_stopped_export_goes_on(tmp_path):
    folder = run(tmp_path / "run")

    def stop(done, _total, _cached):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(folder, tmp_path / "s", application=Toy(2, offset=OLD), on_scores=stop)
    assert not (tmp_path / "s").exists()
    seen = []
    export(
        *(folder, tmp_path / "s"),
        application=Toy(2, offset=OLD),
        on_scores=lambda *counts: seen.append(counts),
    )
    assert seen[0][2] > 0


def test_runs_without_failures_and_failures_that_do_not_repeat_are_told(tmp_path):
    sound = run(tmp_path / "sound", Toy(2, offset=1.0))
    with pytest.raises(UserError, match="none of which fooled the agent"):
        export(sound, tmp_path / "s", application=Toy(2, offset=1.0))
    with pytest.raises(UserError, match=r"made it in Python, hand it over"):
        export(run(tmp_path / "run"), tmp_path / "s")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda text: text[: len(text) // 2], "no JSON"),
        (lambda text: "[]", "another one"),
        (lambda text: text.replace('"version": 2', '"version": 3', 1), "Update sada_gym"),
        (lambda text: text.replace('"C01-01"', '"F01-01"', 1), "'F01-01' twice"),
        (lambda text: text.replace('"unit": "deg"', '"unite": "deg"', 1), "unite"),
        (lambda text: text.replace('"low": -90.0', '"low": 900.0', 1), "low < high"),
        (lambda text: re.sub('"angle0_deg": [^,]*', '"angle0_deg": -80.0', text), "Edit both"),
        (lambda text: text.replace('"seeds": [', '"seeds": [-1,', 1), "seeds"),
        (lambda text: text.replace('"mu": [', '"mu": [0.1,', 1), "2 values from -1 to 1"),
        (lambda text: re.sub('"fooled_seeds": [0-9]+', '"fooled_seeds": 99', text), "99"),
        (lambda text: re.sub("Q > [0-9.]+ for", "Q > 0.9 for", text), "only says in words"),
    ],
)
def test_a_damaged_suite_is_one_sentence(toy, tmp_path, edit, message):
    path = tmp_path / "suite.json"
    path.write_text(edit(toy.read_text()))
    with pytest.raises(UserError, match=message):
        regress(path, Toy(2, offset=OLD))


def test_what_does_not_fit_a_suite_is_one_sentence(toy, tmp_path):
    class Other(Toy):
        name = "Other<b>"

    with pytest.raises(UserError, match="Expected an application Toy as the agent"):
        regress(toy, Other())
    with pytest.raises(UserError, match="was made in Python"):
        regress(toy, "new.zip")
    with pytest.raises(UserError, match="as a name, a file or an Application, got 3"):
        regress(toy, 3)
    with pytest.raises(FileError, match="no such file"):
        regress(tmp_path / "none", Toy(2))


def test_neighbourhoods_see_that_an_angle_goes_around():
    around = ParameterSpace(
        Parameter("azimuth_deg", -180.0, 180.0, "deg", directions=("a", "b", "c", "d")),
        Parameter("x", 0.0, 1.0),
    )
    mu = np.array([[-0.98, 0], [0.97, 0.1], [0.0, 0], [0.05, 0.05], [0.02, 0]], np.float32)
    groups = [sorted(rows.tolist()) for rows in neighbourhoods(places(mu, around), 2)]
    assert groups == [[2, 3, 4], [0, 1]]


def test_the_nearest_free_world_is_matched_once():
    points, candidates = np.array([[0.0], [0.1], [0.2]]), np.array([[5.0], [0.05], [1.0]])
    assert match(points, candidates, {0, 1}) == {0: 1, 1: 0}


def test_a_group_is_described_by_what_is_narrower_than_chance():
    space = ParameterSpace(*(Parameter(name, 0.0, 10.0, "m") for name in ("a_m", "b_m", "c_m")))
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (8, 3)).astype(np.float32)
    assert words(mu, space) == "nowhere in particular"
    mu[:, 1] = np.linspace(0.0, 0.2, 8)
    assert words(mu, space) == "b 5 to 6 m"
    assert words(mu[:2], space) == "too few worlds to say where"
