"""The results in docs/results/ are what the benchmark wrote, of the agents that are shipped."""

from pathlib import Path

import pytest

from sada_gym.benchmark.results import RESULTS_FILE, Results
from sada_gym.benchmark.tables import TABLE_FILE, write_tables
from sada_gym.registration import make_application
from sada_gym.results import read_model

DOCS = Path(__file__).parents[2] / "docs"
FOLDERS = sorted(path.parent for path in (DOCS / "results").glob(f"*/{RESULTS_FILE}"))

every = pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)


def test_there_are_published_results():
    assert FOLDERS


@every
def test_the_tables_tell_the_results(folder, tmp_path):
    results = read_model(folder / RESULTS_FILE, Results)
    told = write_tables(tmp_path, results).read_text(encoding="utf-8")
    assert told == (folder / TABLE_FILE).read_text(encoding="utf-8")


@every
def test_they_are_of_the_shipped_agents_and_present_environments(folder):
    targets = read_model(folder / RESULTS_FILE, Results).targets
    for target in targets:
        application = make_application(target.track, agent=target.agent)
        assert application.version == target.version
        assert application.fingerprint == target.fingerprint
