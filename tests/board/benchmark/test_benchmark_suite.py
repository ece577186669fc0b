import numpy as np
import pytest
from bench_toys import ANALYTIC, make_reference, suite

from sada_gym import adversaries
from sada_gym.adversaries.bbgan import split_budget
from sada_gym.board.benchmark import suite as suites
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.suite import (
    ADVERSARIES,
    CONTROLS,
    SUITES,
    Budget,
    choose,
    find_adversary,
    find_suite,
)
from sada_gym.board.results import paper
from sada_gym.board.submission.current import board_tracks
from sada_gym.experiment.ideal import IDEAL
from sada_gym.foundations.registration import tracks


def made(label, dimension):
    return find_adversary(label)[1].make(dimension, seed=0, ideal_set=None)


def queries(budget, label, dimension):
    return budget.of(find_adversary(label)[1].name, made(label, dimension))


def test_the_suites_name_what_there_is():
    for each in SUITES:
        assert set(each.tracks) <= set(board_tracks())
    assert {spec.name for spec in ADVERSARIES.values()} == {IDEAL, *adversaries.names()}
    assert all(spec.label == label for label, spec in ADVERSARIES.items())
    assert {"ideal", "memorise"} == CONTROLS


SEEDS_OF_DETECTION = {f"SADA-Detection-{name}-v0": 3 for name in ("Bicycle", "Motorbike", "Truck")}


@pytest.mark.parametrize(
    ("name", "application", "table", "seeds", "seeds_of"),
    [
        ("detection", "Detection", "equal-queries", 1, SEEDS_OF_DETECTION),
        ("driving", "Driving", "paper-budgets", 3, {}),
        ("racing", "UAV", "paper-budgets", 3, {}),
        ("robot", "Robot", "paper-budgets", 3, {}),
        ("digits", "Digits", "paper-budgets", 3, {}),
    ],
)
def test_an_application_s_suite(name, application, table, seeds, seeds_of):
    chosen = find_suite(name)
    assert set(chosen.tracks) == {track for track in tracks() if f"-{application}-" in track}
    assert [(each.name, each.agents) for each in chosen.tables] == [(table, "default")]
    assert chosen.adversaries == ADVERSARIES
    for track in chosen.tracks:
        assert chosen.seeds_on(track) == range(seeds_of.get(track, seeds)), track


def test_the_quick_suite():
    quick = find_suite("quick")
    assert set(quick.tracks) == set(SEEDS_OF_DETECTION)
    assert [(table.name, table.agents) for table in quick.tables] == [("equal-queries", "default")]
    assert quick.adversaries == ADVERSARIES
    assert [len(quick.seeds_on(track)) for track in quick.tracks] == [1, 1, 1]


def test_the_budgets_of_the_tables():
    paper_budgets, equal, others = (
        suites.TABLES[name] for name in ("paper-budgets", "equal-queries", "other-agents")
    )
    detection = paper_budgets.budget_of["SADA-Detection"]
    asked = {label: queries(detection, label, 8) for label in ("random", "bbgan", "bayesian")}
    assert asked == {"random": 20_000, "bbgan": 20_000, "bayesian": 10_000}
    assert queries(paper_budgets.budget, "bayesian", 3) == 1_000
    for label in ("random", "bayesian", "bbgan-boost", "bbgan-boost (paper)"):
        assert queries(equal.budget, label, 8) == 2_000
        assert queries(others.budget, label, 8) == 1_000
        assert queries(others.budget_of["SADA-Detection"], label, 8) == 2_000
    assert set(equal.budget_of) == set()
    assert {table.name for table in suites.TABLES.values()} == set(suites.TABLES)


def test_the_suites_of_table_1_share_their_rule_with_those_of_the_applications():
    rows, columns = find_suite("table-1"), find_suite("table-1-columns")
    tracks_of_columns = {track for track in paper.TABLE_1_COLUMNS.values() if track}
    assert set(columns.tracks) == tracks_of_columns
    assert set(rows.tracks) == tracks_of_columns | set(paper.CLASS_COLUMNS.values())
    assert set(rows.tracks) <= set(tracks())
    assert set(rows.adversaries) == {IDEAL, *paper.ROWS} - {paper.FULL_SET}
    assert columns.adversaries == ADVERSARIES
    # one folder of entries serves them all, because the rule is the same
    for each in (rows, columns, find_suite("driving"), find_suite("racing")):
        assert [table.name for table in each.tables] == ["paper-budgets"]
        assert each.tables[0].agents == "default"


def test_the_suite_of_agents_attacks_the_others_of_every_application_that_has_any():
    agents = find_suite("agents")
    [table] = agents.tables
    assert (table.name, table.agents) == ("other-agents", "others")
    assert set(agents.tracks) == {
        track
        for track in tracks()
        if track.split("-")[1] in {"Detection", "Driving", "UAV", "Robot"}
    }
    taking_part = {label for label in agents.adversaries if table.includes(label)}
    assert taking_part == set(table.adversaries)  # each is a row that there is


@pytest.mark.parametrize(
    ("agents", "attacked"),
    [
        ("default", ["b"]),
        ("all", ["b", "a", "c"]),
        ("others", ["a", "c"]),
        (("c", "mine"), ["c", "mine"]),
    ],
)
def test_a_table_says_which_agents_it_attacks(agents, attacked):
    table = find_suite("driving").tables[0].model_copy(update={"agents": agents})
    assert table.attacked("b", ("a", "b", "c")) == attacked


@pytest.mark.parametrize("label", ["bbgan-boost", "bbgan-boost (paper)"])
@pytest.mark.parametrize("count", [20_000, 1_000, 333])
def test_boosting_comes_on_top(label, count):
    budget = queries(Budget(queries=count, boosting_on_top=True), label, 8)
    uniform, _ = split_budget(budget, made(label, 8).options)
    assert abs(uniform - count) <= 2
    assert budget > count
    assert queries(Budget(queries=count), label, 8) == count


@pytest.mark.parametrize(
    ("text", "label", "adversary", "preset"),
    [
        ("bbgan", "bbgan", "bbgan", None),
        ("bbgan (paper)", "bbgan (paper)", "bbgan", "paper"),
        ("bbgan:paper", "bbgan (paper)", "bbgan", "paper"),
        ("bbgan:default", "bbgan", "bbgan", None),
        ("bbgan:mine", "bbgan (mine)", "bbgan", "mine"),
        ("toy:Greedy", "toy:Greedy", "toy:Greedy", None),
        ("ideal", "ideal", "ideal", None),
    ],
)
def test_adversaries_by_what_people_write(text, label, adversary, preset):
    known_label, spec = find_adversary(text)
    assert (known_label, spec.name, spec.preset) == (label, adversary, preset)


def test_a_choice_changes_what_is_given_and_nothing_else():
    original = find_suite("detection").model_copy(
        update={"tables": tuple(suites.TABLES[name] for name in ("paper-budgets", "equal-queries"))}
    )
    assert choose(original) == original
    changed = choose(
        original,
        tracks=["x"],
        chosen=["level-set", "bbgan:paper"],
        agents=["surveyor"],
        seeds=2,
        budget=9,
    )
    assert changed.tracks == ("x",)
    assert list(changed.adversaries) == ["level-set", "bbgan (paper)"]
    assert {table.agents for table in changed.tables} == {("surveyor",)}
    assert changed.seeds_on("SADA-Detection-Truck-v0") == range(2)
    assert [table.budget.queries for table in changed.tables] == [9, 9]
    assert [table.budget.boosting_on_top for table in changed.tables] == [True, False]
    assert all(table.budget_of == {} for table in changed.tables)
    assert [table.name for table in choose(original, tables=["equal-queries"]).tables] == [
        "equal-queries"
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tables": ["equal"]}, "Expected the table to be one of equal-queries; got 'equal'"),
        ({"chosen": ["bbgn"]}, "Did you mean bbgan"),
        ({"chosen": ["gp", "gp:default"]}, "Expected distinct adversaries, got 'gp' twice"),
        ({"seeds": 0}, "Expected seeds of at least 1, got 0"),
        ({"budget": 0}, "Expected budget of at least 1, got 0"),
        ({"samples": 0}, "Expected samples of at least 1, got 0"),
        ({"tracks": ["a.toml"]}, "ids of environments, got the file a.toml"),
    ],
)
def test_bad_choices_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        choose(find_suite("detection"), **changes)


def test_a_plan_is_checked_beforehand(tmp_path):
    for chosen, message in (
        (suite("bbgan:papr"), "Expected an adversary's name or module:Class"),
        (choose(suite("random"), chosen=["bbgan:papr"]), "preset"),
        (suite("random", track="SADA-Nothing-v0"), "Expected a registered environment id"),
        (choose(suite("random"), agents=["surveyor"]), "Expected the keyword of SADA-Analytic-v0"),
        (suite("ideal"), "got nothing. SADA-Analytic-v0 has no reference set"),
    ):
        with pytest.raises(ValueError, match=message):
            make_plan(chosen, tmp_path)


def test_what_lacks_its_package_is_left_out(tmp_path, monkeypatch):
    packages = {"gaussian": "no_such_package"}
    monkeypatch.setattr("sada_gym.adversaries.registry._PACKAGES", packages)
    plan = make_plan(suite("gaussian", "random"), tmp_path)
    assert {run.label for run in plan.runs} == {"random"}
    assert "gaussian is left out: it needs the package no_such_package" in plan.notes[0]


def test_tables_choose_the_agents(tmp_path):
    track = "SADA-Detection-Bicycle-v0"
    chosen = suite("random", track=track, budgets=(9, 8))
    tables = (chosen.tables[0], chosen.tables[1].model_copy(update={"agents": "all"}))
    plan = make_plan(chosen.model_copy(update={"tables": tables}), tmp_path)
    assert [group.target.agent for group in plan.groups] == ["photographer", "surveyor"]
    assert [[run.key.table for run in group.runs] for group in plan.groups] == [
        ["n9", "n8"],
        ["n8"],
    ]
    assert len({run.experiment.target.application.fingerprint for run in plan.runs}) == 2
    with pytest.raises(ValueError, match="Did you mean 'surveyor'"):
        make_plan(choose(chosen, agents=["surveyr"]), tmp_path)


def test_tables_choose_their_adversaries(tmp_path):
    track = "SADA-Detection-Bicycle-v0"
    chosen = suite("random", "gaussian", track=track, budgets=(9, 8))
    few = {"agents": "others", "adversaries": ("gaussian",)}
    tables = (chosen.tables[0], chosen.tables[1].model_copy(update=few))
    plan = make_plan(chosen.model_copy(update={"tables": tables}), tmp_path)
    assert [(run.key.agent, run.key.table, run.label) for run in plan.runs] == [
        ("photographer", "n9", "random"),
        ("photographer", "n9", "gaussian"),
        ("surveyor", "n8", "gaussian"),
    ]


def test_the_longest_groups_come_first_and_a_seed_at_a_time(tmp_path):
    chosen = suite("random", seeds=2).model_copy(update={"tracks": (ANALYTIC, "toy:Toy-v0")})
    order = [(group.target.track, group.seed) for group in make_plan(chosen, tmp_path).groups]
    assert order == [(ANALYTIC, 0), ("toy:Toy-v0", 0), (ANALYTIC, 1), ("toy:Toy-v0", 1)]


def test_the_papers_tables_are_whole():
    columns = {track or paper.AVERAGE for track in paper.TABLE_1_COLUMNS.values()}
    assert len(columns) == 10
    for name, row in paper.TABLE_1.items():
        dashes = {track for track in columns if track.startswith(("SADA-Driving", "SADA-UAV"))}
        assert set(row) == columns - (dashes if name == "Bayesian" else set()), name
    classes = paper.CLASS_COLUMNS.values()
    assert len(classes) == 12
    assert set(paper.CLASS_COLUMNS.values()) == {t for t in tracks() if "-Detection-" in t}
    assert set(paper.ROWS) <= {paper.FULL_SET, *ADVERSARIES}
    for name, row in paper.CLASS_TABLE.items():
        if name not in {"Full Set", "GP Regression"}:  # printed so, though it is not their mean
            mean = np.mean([row[track] for track in classes])
            assert mean == pytest.approx(row[paper.AVERAGE], abs=0.1), name
        assert set(row) == {*classes, paper.AVERAGE, "mu_std"}
    truck = paper.rates_of(paper.TABLE_1, "SADA-Detection-Truck-v0")
    assert truck["bbgan"] == 90.8
    assert "level-set" not in truck
    assert paper.rates_of(paper.TABLE_1, paper.AVERAGE)["bbgan-boost (paper)"] == 80.5
    assert "bayesian" not in paper.rates_of(paper.TABLE_1, "SADA-UAV-5Anchors-v0")
    bicycle = paper.rates_of(paper.CLASS_TABLE, "SADA-Detection-Bicycle-v0")
    assert bicycle["gmm50"] == 16.4
    assert "level-set" not in bicycle


def test_too_few_samples_to_measure_by_are_refused_beforehand(tmp_path):
    make_reference(tmp_path, ANALYTIC)
    for samples, fits in ((5, False), (6, True)):
        chosen = choose(suite("ideal", "random"), samples=samples)
        if fits:
            assert {
                run.experiment.protocol.samples for run in make_plan(chosen, tmp_path).runs
            } == {6}
            continue
        with pytest.raises(ValueError, match=r"at least 6 test samples on SADA-Analytic-v0.*got 5"):
            make_plan(chosen, tmp_path)
    assert make_plan(choose(suite("random"), samples=5), tmp_path / "none")  # nothing to measure by
