import pytest
from bench_toys import ANALYTIC, make_reference, suite
from typer.testing import CliRunner

from sada_gym.benchmark.merge import merge, merge_files
from sada_gym.benchmark.results import Results
from sada_gym.benchmark.run import run_benchmark
from sada_gym.cli import app
from sada_gym.files import read_model, write_model

WHOLE = suite("ideal", "archive", "random", budgets=(90, 60), seeds=2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    references = tmp_path_factory.mktemp("references")
    make_reference(references, ANALYTIC)
    out = tmp_path_factory.mktemp("whole")
    return run_benchmark(WHOLE, out, references=references).results


def part(results, keep):
    """The results of a benchmark that ran only some of the runs."""
    runs = tuple(run for run in results.runs if keep(run))
    targets = tuple(
        target.model_copy(update={"seeds": tuple(sorted({run.seed for run in runs}))})
        for target in results.targets
    )
    # its own rows must not matter
    return results.model_copy(update={"runs": runs, "targets": targets, "rows": ()})


@pytest.mark.parametrize("key", ["label", "seed", "table"])
def test_parts_make_the_whole(whole, key):
    first = getattr(whole.runs[0], key)
    halves = [
        part(whole, lambda run: getattr(run, key) != first),
        part(whole, lambda run: getattr(run, key) == first),
    ]
    assert merge(halves) == merge(halves[::-1]) == whole


def test_one_table_can_be_taken_over(whole):
    merged = merge([whole], tables=["n60"])
    assert merged.comparisons() == [("n60", "")]
    assert merged.rows == tuple(row for row in whole.rows if row.table == "n60")


def test_some_tracks_and_rows_can_be_taken_over(whole):
    merged = merge([whole], tracks=[ANALYTIC], contenders=["ideal", "random"])
    assert {run.label for run in merged.runs} == {"ideal", "random"}
    assert len(merged.runs) == 2 * 2 * 2  # rows, tables, seeds
    assert merged.targets == whole.targets
    assert merge([merged, merge([whole], contenders=["archive"])]) == whole
    for wrong, message in (
        ({"contenders": ["gp"]}, "adversary to be one of archive, ideal, random"),
        ({"tracks": ["SADA-UAV-3Anchors-v0"]}, f"track to be one of {ANALYTIC}"),
    ):
        with pytest.raises(ValueError, match=message):
            merge([whole], **wrong)
    one = part(whole, lambda run: run.label == "ideal" or run.table == "n60")
    with pytest.raises(ValueError, match="none in common"):
        merge([one], tables=["n90"], contenders=["random"])


def test_a_folder_that_is_merged_is_not_written_over(whole, tmp_path):
    write_model(tmp_path / "results.json", whole)
    before = (tmp_path / "results.json").read_bytes()
    for given in (tmp_path, tmp_path / "results.json"):
        with pytest.raises(ValueError, match="Expected a folder of its own for the report"):
            merge_files([given], tmp_path)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [
        ("results.json", before)
    ]


def test_what_does_not_belong_together_is_refused(whole):
    with pytest.raises(ValueError, match="at least one file"):
        merge([])
    with pytest.raises(ValueError, match=r"every run once, got ideal on .* twice"):
        merge([whole, whole])
    with pytest.raises(ValueError, match="n7"):
        merge([whole], tables=["n7"])
    empty = part(whole, lambda run: False)
    packages = {**whole.settings.packages, "numpy": "1.0"}
    settings = whole.settings.model_copy(update={"packages": packages})
    with pytest.raises(ValueError, match=r"the packages alike, got others: numpy was"):
        merge([whole, empty.model_copy(update={"settings": settings})])
    first, *others = whole.settings.tables
    budget = first.budget.model_copy(update={"queries": 7})
    tables = (first.model_copy(update={"budget": budget}), *others)
    settings = whole.settings.model_copy(update={"tables": tables})
    with pytest.raises(ValueError, match="rule of table n90 alike"):
        merge([whole, empty.model_copy(update={"settings": settings})])
    target = whole.targets[0].model_copy(update={"version": 9})
    with pytest.raises(ValueError, match=rf"{ANALYTIC} against .* alike"):
        merge([whole, empty.model_copy(update={"targets": (target,)})])


def test_files_and_folders_are_merged_on_the_command_line(whole, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        (tmp_path / name).mkdir()
        chosen = part(whole, lambda run, seed=seed: run.seed == seed)
        (tmp_path / name / "results.json").write_text(chosen.model_dump_json())
    out = tmp_path / "out"
    arguments = ["merge", tmp_path / "a", tmp_path / "b" / "results.json", "--out", out]
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == 0, result.output
    assert "12 runs, 1 tracks and agents" in result.stdout.replace("\n", " ")
    assert read_model(out / "results.json", Results) == whole
    assert (out / "table.md").read_text().startswith("# Benchmark results")


def test_a_folder_without_results_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"results\.json"):
        merge_files([tmp_path], tmp_path / "out")
