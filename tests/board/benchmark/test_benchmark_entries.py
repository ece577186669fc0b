"""What a benchmark's entries lack, how runs are added, and which plans have no place in them."""

import json
import shutil
from collections import Counter

import pytest
from bench_toys import ANALYTIC, Inline, contents, made, make_reference, run_in, suite

from sada_gym.board.benchmark.entries import find_missing
from sada_gym.board.benchmark.folder import Timing, read_costs, reserve, sole_user
from sada_gym.board.benchmark.plan import make_plan, metadata_of
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.run import report_benchmark, run_benchmark
from sada_gym.board.benchmark.schedule import do_runs
from sada_gym.board.benchmark.suite import choose, find_adversary, find_suite
from sada_gym.board.results.entry import GroupFiles, read_entry, read_metadata, write_metadata
from sada_gym.board.results.models import MAX_ERROR, SeedResult, Verified
from sada_gym.board.submission.checks import check_entry, find_outdated
from sada_gym.errors import UserError
from sada_gym.evaluation.executors import Workers
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import Experiment, RunFailure

WHOLE = suite("ideal", "random", "memorise", "bench_toys:Picky", budgets=(60,), seeds=2)
PLACE, GROUP = f"{ANALYTIC}.n60", "SADA-Analytic"


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    make_reference(folder, ANALYTIC)
    return folder


def work(out, chosen, references):
    """Do what is missing, and say what that was."""
    plan = make_plan(chosen, references)
    reserve(out)
    entries = out / "entries"
    missing = find_missing(entries, plan)
    do_runs(plan, missing.runs, out, entries, Workers(1, Inline()), BenchmarkCallback())
    return missing


@pytest.fixture(scope="module")
def whole(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("whole")
    assert len(work(out, WHOLE, references).runs) == 8
    return out / "entries"


@pytest.fixture
def copied(whole, tmp_path):
    """A second place, which has the entries and nothing else."""
    shutil.copytree(whole, tmp_path / "out" / "entries")
    return tmp_path / "out"


def names(missing):
    return [(run.label, run.seed) for run in missing.runs]


def test_a_second_place_with_the_entries_alone_has_nothing_to_do(copied, whole, references):
    missing = work(copied, WHOLE, references)
    assert (missing.runs, missing.lacking, missing.outdated) == ((), 0, 0)
    assert contents(copied / "entries") == contents(whole)
    assert read_costs(copied) == []


def test_seeds_results_and_entries_that_are_missing_are_made_again(copied, whole, references):
    shutil.rmtree(copied / "entries" / "memorise")
    (copied / "entries" / "ideal" / f"{GROUP}.json").unlink()
    first = suite("random", budgets=(60,))
    shutil.rmtree(copied / "entries" / "random")
    work(copied, first, references)  # seed 0 alone
    missing = work(copied, WHOLE, references)
    assert sorted(names(missing)) == [
        *(("ideal", 0), ("ideal", 1)),
        *(("memorise", 0), ("memorise", 1)),
        ("random", 1),
    ]
    assert (missing.lacking, missing.outdated) == (3, 0)
    assert contents(copied / "entries") == contents(whole)


def test_killed_between_samples_and_claims_it_makes_that_seed_again(copied, whole, references):
    claims = copied / "entries" / "random" / f"{GROUP}.json"
    shutil.rmtree(claims.parent)
    work(copied, suite("random", budgets=(60,)), references)
    before = claims.read_bytes()
    work(copied, WHOLE, references)
    claims.write_bytes(before)  # the samples of both seeds are there by then
    assert names(work(copied, WHOLE, references)) == [("random", 1)]
    assert contents(copied / "entries") == contents(whole)


def test_an_outdated_result_is_replaced(copied, whole, references, tmp_path):
    changed = choose(suite("random", "gaussian", budgets=(60,)), samples=20)
    missing = work(copied, changed, references)
    assert names(missing) == [("random", 0), ("gaussian", 0)]
    assert (missing.lacking, missing.outdated) == (1, 1)
    result, _, samples = run_in(copied / "entries", "random", "n60")
    assert result.experiment.protocol.samples == len(samples.mu) == 20
    assert [claims.seed for claims in result.seeds] == [0]  # the other one was of the old result
    others = {name for name in contents(whole) if not name.startswith("random/")}
    assert {name: contents(copied / "entries")[name] for name in others} == {
        name: contents(whole)[name] for name in others
    }
    make_reference(tmp_path, ANALYTIC, points=500)
    missing = find_missing(copied / "entries", make_plan(changed, tmp_path))
    assert (len(missing.runs), missing.outdated) == (2, 2)


def test_what_the_plan_does_not_name_is_left_alone(copied, references):
    work(copied, suite("random", budgets=(60,), seeds=3), references)
    before = contents(copied / "entries")
    assert names(work(copied, suite("random", budgets=(60,)), references)) == []
    assert contents(copied / "entries") == before
    assert ("random", PLACE, 2) in made(copied / "entries")


@pytest.mark.parametrize("name", ["digits", "robot"])
def test_what_a_benchmark_makes_is_what_the_checks_expect(name):
    plan = make_plan(find_suite(name))
    for run in plan.runs:
        assert find_outdated(run.experiment) is None, str(run)


def test_what_a_benchmark_writes_passes_the_checks(whole):
    for name in ("random", "ideal", "bench_toys-picky"):
        check_entry(whole / name, submission=False)


def test_a_new_seed_takes_back_what_was_verified(copied, references):
    folder = copied / "entries" / "random"
    before = read_entry(folder).results[PLACE]
    verified = Verified.make(before.claimed, before.samples, ("random", "0" * 64), "x")
    GroupFiles(folder, GROUP).add_verified(PLACE, verified)
    work(copied, WHOLE, references)
    assert read_entry(folder).results[PLACE].verified == verified
    work(copied, suite("random", budgets=(60,), seeds=3), references)
    assert read_entry(folder).results[PLACE].verified is None


def test_claims_are_read_once(copied, references, monkeypatch):
    times, read_claims = Counter(), GroupFiles.read_claims

    def counted(files):
        times[files.claims.parent.name] += 1
        return read_claims(files)

    monkeypatch.setattr(GroupFiles, "read_claims", counted)
    assert find_missing(copied / "entries", make_plan(WHOLE, references)).runs == ()
    assert times == {"ideal": 1, "random": 1, "memorise": 1, "bench_toys-picky": 1}


def test_an_entry_of_another_adversary_is_not_touched(copied, references):
    folder = copied / "entries" / "random"
    path = folder / f"{GROUP}.json"
    claims = json.loads(path.read_text())
    for result in claims["results"]:
        result["experiment"]["adversary"]["name"] = "theirs"
        result["sha256"] = Experiment.model_validate(result["experiment"]).sha256
    path.write_text(json.dumps(claims))
    before = contents(copied / "entries")
    with pytest.raises(UserError, match=r"of the adversary random, got one of theirs\. Give the"):
        find_missing(copied / "entries", make_plan(WHOLE, references))
    assert contents(copied / "entries") == before


def test_an_entry_keeps_its_authors_where_results_are_made_anew(copied, references):
    folder = copied / "entries" / "memorise"
    theirs = read_metadata(folder).model_copy(update={"authors": ("Ada",), "licence": "CC0-1.0"})
    write_metadata(folder, theirs)
    (folder / f"{GROUP}.json").unlink()
    work(copied, WHOLE, references)
    assert read_metadata(folder) == theirs


def test_only_our_adversaries_have_our_name_and_licence():
    label, spec = find_adversary("bbgan (paper)")
    ours = metadata_of(label, spec)
    assert (ours.name, ours.title, spec.preset) == ("bbgan-paper", "bbgan (paper)", "paper")
    assert (ours.licence, ours.command) == ("MIT", "sada-gym benchmark -a 'bbgan (paper)'")
    other = metadata_of("gp", AdversarySpec(name="gp", options={"subset": 9}))
    assert (other.authors, other.licence, other.command) == ((), "", "")


@pytest.mark.parametrize(
    ("label", "options", "reason"),
    [
        ("ж", {}, r"name: .*64 small letters"),
        ("g" * 65, {}, r"name: .*64 small letters"),
        ("a\nb", {}, r"title: .*control characters"),
        ("gp", {"a": {1}}, r"set is not JSON serializable"),
    ],
)
def test_an_adversary_that_no_entry_can_describe_is_refused(label, options, reason):
    with pytest.raises(UserError, match=reason):
        metadata_of(label, AdversarySpec(name="gp", options=options))


def test_runs_that_would_share_a_place_are_refused(tmp_path):
    pair = {label: AdversarySpec(name="random") for label in ("Mine", "mine")}
    chosen = suite("random", budgets=(60,)).model_copy(update={"adversaries": pair})
    with pytest.raises(UserError, match=r"got Mine on SADA.* and mine on SADA.*would share one"):
        make_plan(chosen, tmp_path)
    same = find_suite("driving")
    [table] = same.tables
    twin = table.model_copy(update={"name": table.name.upper()})  # the same on some file systems
    both = choose(
        same.model_copy(update={"tables": (table, twin)}),
        tracks=same.tracks[:1],
        chosen=["random"],
    )
    with pytest.raises(UserError, match=r"paper-budgets and .*PAPER-BUDGETS.*\(--table\)"):
        make_plan(both, tmp_path)
    assert make_plan(choose(both, tables=["PAPER-BUDGETS"]), tmp_path)


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        ("a" * 140, "at most 150 characters in all"),
        ("a" * 201, r"expected the rule in one line of at most 200 characters"),
    ],
)
def test_names_that_no_file_can_have_are_refused(rule, reason, tmp_path):
    chosen = suite("random", budgets=(60,))
    tables = (chosen.tables[0].model_copy(update={"name": rule}),)
    with pytest.raises(UserError, match=rf"{reason}.*shorter names"):
        make_plan(chosen.model_copy(update={"tables": tables}), tmp_path)


def test_an_error_of_any_text_fits_into_an_entry(references, tmp_path):
    plan = make_plan(suite("random", budgets=(60,)), references)
    [run] = plan.runs
    failure = RunFailure(settings=run, error="a\x1b[31m\n\tb" + "c" * 9_000)
    seed = SeedResult.of(failure)
    assert seed.error.startswith(r"a\x1b[31m b")
    assert len(seed.error) == MAX_ERROR


def test_one_benchmark_at_a_time_writes_to_a_folder_of_entries(tmp_path, references):
    entries = tmp_path / "entries"
    entries.mkdir()
    with sole_user(entries), pytest.raises(UserError, match="another is at work there"):
        run_benchmark(WHOLE, tmp_path / "out", entries=entries, references=references)


def test_a_torn_line_of_costs_is_left_out(tmp_path, references):
    work(tmp_path, suite("random", budgets=(60,)), references)
    file = tmp_path / "timings.jsonl"
    file.write_bytes(file.read_bytes() + b'{"table": "n60", "tra')
    work(tmp_path, suite("random", "ideal", budgets=(60,)), references)
    costs = read_costs(tmp_path)
    assert [cost.label for cost in costs] == ["random", "ideal"]
    assert set(Timing.model_fields) < set(type(costs[0]).model_fields)


def test_the_report_leaves_out_what_is_outdated(copied, references, tmp_path):
    make_reference(tmp_path / "others", ANALYTIC, points=500)
    work(copied, suite("gaussian", budgets=(60,)), tmp_path / "others")
    done = report_benchmark(copied, references)
    assert {run.entry for run in done.results.runs} == {
        *("ideal", "random", "memorise", "bench_toys-picky")
    }
    assert done.notes == (
        "One result is left out, because the track or its agent has changed since.",
    )
    assert done.notes[0] in (copied / "table.md").read_text()
    assert {c.table.title for c in done.results.comparisons} == {"n60"}  # the rule's name


def test_the_report_is_the_same_in_a_second_place(copied, whole, references):
    first = report_benchmark(whole.parent, references, suite=WHOLE)
    second = report_benchmark(copied, references, suite=WHOLE)
    assert first.results == second.results
    text = (copied / "table.md").read_text()
    assert text == (whole.parent / "table.md").read_text()
    with pytest.raises(UserError, match="got none yet"):
        report_benchmark(copied, references, suite=choose(WHOLE, tracks=["SADA-Digits-3-v0"]))
