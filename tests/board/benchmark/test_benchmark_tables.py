import pytest
from made_experiments import made_experiment, made_target

from sada_gym.board.benchmark.results import Results, TableComparison
from sada_gym.board.benchmark.suite import Budget, Table
from sada_gym.board.benchmark.tables import short_name, write_tables
from sada_gym.board.results.models import SeedResult
from sada_gym.board.results.paper import CLASS_COLUMNS
from sada_gym.board.results.rows import RunSummary
from sada_gym.experiment.measure import FeasibleRate, Measures, Search
from sada_gym.experiment.target import ReferenceSummary

TRACKS = tuple(CLASS_COLUMNS.values())
TABLE = Table(name="t", title="A table", note="A note.", budget=Budget(queries=2000))


def run(
    track,
    label,
    fooled,
    *,
    seed=0,
    flags=(),
    error=None,
    relative=0.75,
    agent="photographer",
    feasible=None,
):
    measures = Measures(
        afr=fooled / 250,
        afr_interval_95=(0.0, 1.0),
        fooled=fooled,
        mean_score=0.5,
        mu_std=0.3,
        density=0.9,
        coverage=0.6,
        relative_coverage=relative,
        novelty=None,
        image_novelty=None,
        feasible=feasible,
    )
    claims = SeedResult(
        seed=seed,
        queries=0 if error else 2000,
        error=error,
        measures=None if error else measures,
        search=None if error else Search(queries=2000, fooled=700, curve=()),
        flags=flags,
        packages={"numpy": "2.0"},
    )
    return RunSummary(
        label=label,
        entry=label,
        experiment=made_experiment(
            target_of(track, agent), label, rule="t", budget=2000, samples=250, seed=seed
        ),
        claims=claims,
        control=label == "ideal",
        disqualified=False,
    )


def target_of(track, agent):
    application = track.rpartition("-")[0].rpartition("-")[0]
    reference = ReferenceSummary(sha256="0", points=1000, fooling=300, uniform_rate=0.37)
    return made_target(
        track, agent, application=application, fingerprint="abc", reference=reference
    )


def report(tmp_path, runs, notes=()):
    targets = {(run.track, run.experiment.target.agent): run.experiment.target for run in runs}
    agents = dict.fromkeys(agent for _, agent in targets)
    results = Results(
        targets=tuple(targets.values()),
        comparisons=tuple(
            TableComparison(
                TABLE, agent, tuple(run for run in runs if run.experiment.target.agent == agent)
            )
            for agent in agents
        ),
    )
    return write_tables(tmp_path, results, notes).read_text(), results


@pytest.fixture
def whole(tmp_path):
    figures = {"random": (100, 0.25), "bbgan": (200, 0.5), "level-set": (240, 0.75)}
    runs = [
        run(track, label, fooled, relative=relative)
        for label, (fooled, relative) in figures.items()
        for track in TRACKS
    ]
    return report(tmp_path, runs)


def line(text, section, label):
    rest = text.partition(section)[2].partition("\n#")[0]
    [match] = [row for row in rest.splitlines() if row.startswith(f"| {label} |")]
    return [part.strip() for part in match.strip("|").split("|")]


def test_it_is_laid_out_like_the_papers_table(whole):
    text, _ = whole
    section = "Compared with the paper's Table 1"
    header = ["adversary", "Bicycle", "Motorbike", "Truck", "12-class avg"]
    assert line(text, section, "adversary") == header
    assert line(text, section, "full set") == [
        "full set",
        *("37.0 / 14.6", "37.0 / 32.5", "37.0 / 56.8", "37.0 / 37.1"),
    ]
    bbgan = ["bbgan", "80.0 / 44.0", "80.0 / 45.2", "80.0 / 90.8", "80.0 / 74.5"]
    assert line(text, section, "bbgan") == bbgan
    assert line(text, section, "level-set") == [
        "level-set",
        "**96.0**",
        "**96.0**",
        "**96.0**",
        "96.0",
    ]


def test_all_classes_stand_beside_the_appendix(whole):
    text, _ = whole
    header = line(text, "### By class", "adversary")
    assert header == ["adversary", *CLASS_COLUMNS, "12-class avg", "μ_std"]
    random = line(text, "### By class", "random")
    assert random[1] == "40.0 / 11.3"
    assert random[-2:] == ["40.0 / 46.2", "0.300 / 0.584"]


def test_the_measures_stand_with_intervals_and_ranks(whole):
    text, results = whole
    assert "mean over 12 tracks" in text
    own = line(text, "### All measures", "level-set")
    [row] = [r for r in results.rows_of("t", "photographer", None) if r.label == "level-set"]
    texts = [
        f"{100 * figure.value:.1f} ({100 * low:.1f} to {100 * high:.1f})"
        for figure in (row.f1, row.afr)
        for low, high in [figure.interval_95]
    ]
    assert own[1:4] == [texts[0], "1", texts[1]]
    assert texts[0].startswith("84.2 (")
    assert texts[1].startswith("96.0 (")
    assert own[5] == "75.0"  # one seed a track tells of no interval
    assert own[-1] == "12"


def test_all_applications_stand_in_one_table_by_their_default_agents(tmp_path):
    driving = "SADA-Driving-OneCurve-v0"
    agents = [(TRACKS[2], "photographer"), (TRACKS[2], "surveyor"), (driving, "cil")]
    runs = [
        run(track, label, fooled + 5 * (agent == "surveyor"), agent=agent, relative=relative)
        for track, agent in agents
        for label, fooled, relative in (("random", 100, 0.5), ("bbgan", 200, 0.9))
    ]
    text, _ = report(tmp_path, runs)
    [section] = [title for title in text.splitlines() if title.endswith("all applications")]
    assert section == "## A table: all applications"
    whole = text.partition(section)[2].partition("\n## ")[0]
    assert "Agents: photographer, cil. A dash" in whole
    header = ["adversary", "Bicycle", "One Curve"]
    assert line(whole, "Compared with the paper's Table 1", "adversary") == header
    assert line(whole, "Compared with the paper's Table 1", "bbgan") == [
        "bbgan",
        "**80.0** / 44.0",
        "**80.0** / 98.0",
    ]
    assert line(whole, "The same columns: coverage", "adversary") == header
    assert line(whole, "The same columns: coverage", "random") == ["random", "50.0", "50.0"]


def test_other_agents_stand_in_no_table_of_all_applications(tmp_path):
    agents = [(TRACKS[2], "surveyor"), ("SADA-Driving-OneCurve-v0", "ppo")]
    text, _ = report(tmp_path, [run(track, "random", 100, agent=agent) for track, agent in agents])
    assert "all applications" not in text
    assert "## A table, Self-driving, ppo" in text


def test_one_application_has_no_such_table(whole):
    assert "all applications" not in whole[0]


def test_the_rate_over_feasible_worlds_has_a_column_where_it_is_known(tmp_path, whole):
    assert "feasible" not in whole[0]
    half = FeasibleRate(worlds=200, fooled=80, afr=0.4)
    text, _ = report(tmp_path, [run(TRACKS[0], "random", 100, feasible=half)])
    at = line(text, "### All measures", "adversary").index("AFR, feasible, %")
    assert line(text, "### All measures", "random")[at] == "40.0"
    assert "- AFR, feasible: the AFR over those" in text


def test_fewer_classes_are_no_12_class_average(tmp_path):
    text, _ = report(tmp_path, [run(track, "random", 100) for track in TRACKS[:11]])
    assert "12-class avg" not in text
    assert line(text, "### By class", "adversary")[-2] == "mean of 11 tracks"
    assert line(text, "### By class", "random")[-2:] == ["40.0", "0.300"]


def test_coverage_stands_beside_the_afr_of_every_track(tmp_path):
    runs = [
        run(TRACKS[0], "random", 100, relative=0.5),
        run(TRACKS[1], "random", 100, relative=0.7),
        run(TRACKS[0], "level-set", 240, relative=None),
        run(TRACKS[1], "level-set", 240, relative=0.9),
    ]
    text, _ = report(tmp_path, runs)
    section = "### By class: coverage / ideal, %"
    assert line(text, section, "adversary")[1:] == ["aeroplane", "bench", "mean of 2 tracks"]
    assert line(text, section, "random")[1:] == ["50.0", "70.0", "60.0"]
    assert line(text, section, "level-set")[1:] == ["-", "90.0", "-"]


def test_without_coverage_there_is_no_such_table(tmp_path):
    text, _ = report(tmp_path, [run(TRACKS[0], "random", 100, relative=None)])
    assert "coverage / ideal, %\n" not in text.partition("### By class")[2]


def test_the_front_counts_tracks_where_nobody_is_better_in_both(tmp_path):
    figures = {  # fooled and coverage on two tracks
        "ideal": ((250, 1.0), (250, 1.0)),
        "level-set": ((200, 0.9), (200, 0.9)),
        "gp": ((240, 0.8), (210, 0.95)),
        "random": ((200, 0.9), (100, 0.5)),  # a tie in both is not better
    }
    runs = [
        run(track, label, fooled, relative=relative)
        for label, points in figures.items()
        for track, (fooled, relative) in zip(TRACKS, points, strict=False)
    ]
    text, _ = report(tmp_path, runs)
    at = line(text, "### All measures", "adversary").index("front")
    fronts = {label: line(text, "### All measures", label)[at] for label in figures}
    assert fronts == {"ideal": "", "level-set": "1 of 2", "gp": "2 of 2", "random": "1 of 2"}


def test_errors_flags_and_notes_are_told(tmp_path):
    runs = [
        run(TRACKS[0], "random", 100),
        run(TRACKS[0], "smc", 0, error="Expected a budget of 99 | more."),
        run(TRACKS[0], "bbgan", 100, flags=("nothing fooled",)),
        run(TRACKS[1], "random", 100),
        run(TRACKS[1], "bbgan", 100, flags=("nothing fooled",)),
    ]
    text, _ = report(tmp_path, runs, ["ribs is missing."])
    assert "- ribs is missing." in text
    assert "- smc (t, one run): failed: Expected a budget of 99 | more." in text
    assert "- bbgan (t, 2 runs): nothing fooled" in text
    smc = line(text, "### All measures", "smc")
    assert (smc[1], smc[-1]) == ("-", "0, 1 failed (incomplete)")
    assert line(text, "### By class", "smc")[1:3] == ["-", "-"]


@pytest.mark.parametrize(
    ("track", "name"),
    [
        ("SADA-Detection-DiningTable-v0", "diningtable"),
        ("SADA-UAV-3Anchors-v1", "UAV-3Anchors"),
        ("mine:Own-v0", "mine:Own"),
        ("Own", "Own"),
    ],
)
def test_short_names(track, name):
    assert short_name(track) == name
