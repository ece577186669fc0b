"""The results in docs/results/ are what the benchmark wrote, of the agents that are shipped."""

import json
from pathlib import Path

import pytest

from sada_gym.benchmark.merge import merge_files
from sada_gym.benchmark.plan import make_plan
from sada_gym.benchmark.report.tables import TABLE_FILE, write_tables
from sada_gym.benchmark.results import RESULTS_FILE, Results
from sada_gym.benchmark.suite import find_suite
from sada_gym.files import read_model
from sada_gym.registration import make_application
from sada_gym.runs.record import RunKey

DOCS = Path(__file__).parents[2] / "docs"
FOLDERS = sorted(path.parent for path in (DOCS / "results").glob(f"*/{RESULTS_FILE}"))

every = pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)


def test_there_are_published_results():
    assert FOLDERS


@every
def test_the_tables_tell_the_results(folder, tmp_path):
    results = read_model(folder / RESULTS_FILE, Results)
    compared = write_tables(tmp_path, results).read_text(encoding="utf-8")
    assert compared == (folder / TABLE_FILE).read_text(encoding="utf-8")


@every
def test_their_format_is_read_and_written_to_the_byte(folder):
    results = read_model(folder / RESULTS_FILE, Results)
    # less what has a default and came later than they
    held = results.model_dump(mode="json", exclude_unset=True)
    written = f"{json.dumps(held, indent=2, allow_nan=False)}\n"
    assert written.encode() == (folder / RESULTS_FILE).read_bytes()


@every
def test_they_are_of_the_shipped_agents_and_present_environments(folder):
    targets = read_model(folder / RESULTS_FILE, Results).targets
    for target in targets:
        application = make_application(target.track, agent=target.agent)
        assert application.version == target.version
        assert application.fingerprint == target.fingerprint


@pytest.fixture(scope="module")
def merged(tmp_path_factory):
    """The applications' results in one, and where its tables are."""
    out = tmp_path_factory.mktemp("table-1")
    results = [DOCS / "results" / name for name in ("detection", "driving", "racing")]
    return merge_files(results, out, tables=("paper-budgets",)), out / TABLE_FILE


def test_table_1_is_the_applications_results(merged):
    _, table = merged
    published = DOCS / "results" / "table-1" / TABLE_FILE
    assert table.read_text(encoding="utf-8") == published.read_text(encoding="utf-8")


def test_the_suite_of_table_1_runs_the_same(merged):
    results, _ = merged
    fields = {*RunKey.model_fields, "adversary", "preset", "options", "budget", "samples"}

    def compared(runs):
        return sorted(json.dumps(c.model_dump(include=fields), sort_keys=True) for c in runs)

    assert compared(results.runs) == compared(make_plan(find_suite("table-1")).runs)
