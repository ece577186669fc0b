"""A run's failures as records of test cases and as SARIF, and the domain that it tried."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from toy import Toy
from typer.testing import CliRunner

from sada_gym import attack
from sada_gym.analyses.domain import CELLS, Domain
from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.records import as_csv, as_sarif, records
from sada_gym.analyses.regression.suite import Ranged, read_suite
from sada_gym.cli import app
from sada_gym.errors import UserError
from sada_gym.parameters import Parameter

OFFSET = 0.1


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    keywords = {"budget": 80, "samples": 100, "seed": 0, "pictures": False}
    return attack(Toy(2, offset=OFFSET), "gmm50", out=folder / "run", **keywords)


@pytest.fixture(scope="module")
def suite(run):
    path = run.folder.parent / "suite.json"
    return export(run, path, application=Toy(2, offset=OFFSET)).suite


def test_a_record_says_what_a_test_case_must(suite):
    found = records(suite)
    assert [record.identifier for record in found] == [case.id for case in suite.test_cases]
    first, case = found[0], suite.test_cases[0]
    assert first.kind == "failure"
    assert first.objective == suite.groups[0]
    assert [*first.inputs.values()] == [*case.concrete_scenario.values()]
    assert first.seeds == case.seeds
    assert first.actual_result == f"fooled on {case.fooled_seeds} of 3 seeds"
    assert first.frequency == case.fooled_seeds / 3
    assert first.expected_result == suite.pass_criterion
    assert re.fullmatch("[0-9a-f]{64}", first.platform["ranges_sha256"])
    assert first.platform["numpy"] == np.__version__


def test_other_ranges_have_another_sha256(suite):
    other = suite.logical_scenario[0].model_copy(update={"high": 99.0})
    changed = suite.model_copy(update={"logical_scenario": (other, *suite.logical_scenario[1:])})
    one, two = (records(each)[0].platform["ranges_sha256"] for each in (suite, changed))
    assert one != two


def test_choices_and_whole_numbers_are_told_as_such(suite):
    ranges = (
        Ranged.of(Parameter("light", 0.0, 1.0, choices=("day", "night"))),
        Ranged.of(Parameter("cars", -0.5, 3.5, whole=True)),
        Ranged.of(Parameter("lanes", 0.5, 2.5, whole=True, choices=("1", "2"))),
    )
    scenario = {"light": 0.75, "cars": 2.2, "lanes": 2.5}
    case = suite.test_cases[0].model_copy(update={"concrete_scenario": scenario})
    update = {"test_cases": (case,), "logical_scenario": ranges}
    (record,) = records(suite.model_copy(update=update))
    assert record.inputs == {"light": "night", "cars": 2, "lanes": 2}


def test_the_table_has_a_row_a_case(suite):
    rows = [*csv.DictReader(io.StringIO(as_csv(suite).decode()))]
    assert len(rows) == len(suite.test_cases)
    assert rows[0]["identifier"] == "F01-01"
    assert len(rows[0]["seeds"].split()) == 3


def test_a_parameter_with_the_name_of_a_field_has_a_column_of_its_own(suite):
    ranges = tuple(Ranged.of(Parameter(name, 0.0, 1.0)) for name in ("frequency", "agent", "kind"))
    scenario = {"frequency": 0.25, "agent": 0.5, "kind": 0.75}
    case = suite.test_cases[0].model_copy(update={"concrete_scenario": scenario})
    changed = suite.model_copy(update={"test_cases": (case,), "logical_scenario": ranges})
    (row,) = csv.DictReader(io.StringIO(as_csv(changed).decode()))
    assert [row[f"{name} (input)"] for name in scenario] == ["0.25", "0.5", "0.75"]
    assert row["kind"] == "failure"
    assert float(row["frequency"]) == case.fooled_seeds / 3


def test_sarif_has_a_rule_a_group_and_a_result_a_failure(suite):
    log = json.loads(as_sarif(suite))
    (told,) = log["runs"]
    failures = [case for case in suite.test_cases if case.objective == "failure"]
    assert log["version"] == "2.1.0"
    assert len(told["results"]) == len(failures)
    rules = told["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in rules] == [f"F{k:02}" for k in range(1, len(suite.groups) + 1)]
    for result, case in zip(told["results"], failures, strict=True):
        assert rules[result["ruleIndex"]]["id"] == result["ruleId"] == f"F{case.group:02}"
        assert case.id in result["message"]["text"]
        assert "locations" not in result  # an agent that is no file
    marks = [result["partialFingerprints"]["world/v1"] for result in told["results"]]
    assert len({*marks}) == len(marks)


def test_sarif_names_a_file_from_the_current_folder(suite, tmp_path, monkeypatch):
    def uri(file):
        result = json.loads(as_sarif(suite, file))["runs"][0]["results"][0]
        return result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]

    monkeypatch.chdir(tmp_path)
    assert uri(Path("out/../agents/my agent.zip")) == "agents/my%20agent.zip"
    assert uri(tmp_path / "pole.toml") == "pole.toml"
    assert uri(tmp_path.parent / "pole.toml") == (tmp_path.parent / "pole.toml").as_uri()


def test_forms_of_export(run, tmp_path):
    toy = Toy(2, offset=OFFSET)
    cases = export(run, tmp_path / "cases.csv", form="cases", application=toy)
    assert cases.path.read_bytes() == as_csv(cases.suite)
    sarif = export(run, tmp_path / "a.sarif", form="sarif", application=toy)
    assert json.loads(sarif.path.read_text())["runs"]
    with pytest.raises(UserError, match="forms suite, cases, sarif, got 'pdf'"):
        export(run, tmp_path / "a.pdf", form="pdf", application=toy)
    with pytest.raises(UserError, match="suite"):
        read_suite(sarif.path)


def test_the_domain_counts_each_world_once_a_parameter(run):
    domain = Domain.of(run)
    assert domain.worlds == 180
    for one in domain.ranges:
        assert len(one.cells) == CELLS
        assert sum(cell.worlds for cell in one.cells) == 180
        assert one.cells[0].low == one.low
        assert one.cells[-1].high == one.high
    fooled = sum(cell.failures.fooled for cell in domain.ranges[0].cells if cell.failures)
    both = run.queries.score, run.samples.score
    assert fooled == sum((score <= run.target.fooling_threshold).sum() for score in both)
    assert domain.pairs == 25
    assert 20 <= domain.pairs_tried <= 25


def test_the_domain_in_openodd(run, tmp_path):
    text = Domain.of(run).as_openodd().decode()
    for one in Domain.of(run).ranges:
        assert f'world.{one.name}: "[{one.low:.9g} .. {one.high:.9g}]"' in text
    openodd = pytest.importorskip("openodd")
    assert openodd.load_openodd(text)


@pytest.mark.parametrize(
    ("name", "first"), [("a.csv", b"parameter,unit"), ("a.json", b"{"), ("a.yaml", b"# ")]
)
def test_the_command_writes_a_domain(run, tmp_path, name, first):
    arguments = ["export", str(run.folder), "--format", "odd", "--out", str(tmp_path / name)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert (tmp_path / name).read_bytes().startswith(first)


def test_the_command_names_what_it_can_write(run, tmp_path):
    arguments = ["export", str(run.folder), "--format", "odd", "--out", str(tmp_path / "a.pdf")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert ".csv, .yaml, .json" in done.output
    arguments[3] = "pdf"
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert "suite, cases, sarif, odd" in done.output
