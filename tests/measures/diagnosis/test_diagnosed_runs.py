"""The diagnosis of runs: at the end of an attack, and again by its command."""

from __future__ import annotations

import json
import shutil

import pytest
from toy import Toy
from toy_attacks import run as toy_attack
from typer.testing import CliRunner

from sada_gym import attack, diagnose, make_application
from sada_gym.cli import app
from sada_gym.errors import FileError, Notice, UserError
from sada_gym.measures.diagnosis.record import DIAGNOSIS_FILE, read_diagnosis
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.measures.failures import read_failures
from sada_gym.run.folder import RESULT_FILE, STORE_FILE


def command(*args):
    return CliRunner().invoke(app, [*map(str, args)], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("runs") / "a <b> 'run'"
    attack("SADA-Analytic-v0", "gaussian", budget=400, samples=50, out=place, pictures=False)
    return place


def test_an_attack_ends_with_a_diagnosis_and_a_resumed_one_reads_it(tmp_path):
    log = tmp_path / "evaluated.log"
    result = toy_attack(tmp_path / "run", Toy(log=str(log)))
    assert result.diagnosis is not None
    assert result.diagnosis.fresh >= 30  # 15 in the rule and 15 outside, not 5 % of the budget
    assert read_diagnosis(result.folder) == result.diagnosis
    assert "elsewhere" in str(result)
    evaluated = log.read_text()
    again = toy_attack(tmp_path / "run", Toy(log=str(log)), resume=True)
    assert again.diagnosis == result.diagnosis
    (tmp_path / "run" / DIAGNOSIS_FILE).unlink()
    made = toy_attack(tmp_path / "run", Toy(log=str(log)), resume=True)
    assert made.diagnosis == result.diagnosis
    assert log.read_text() == evaluated  # the store knew all of it
    assert toy_attack(tmp_path / "without", diagnose=False).diagnosis is None
    assert not (tmp_path / "without" / DIAGNOSIS_FILE).exists()


def test_the_command_says_what_the_attack_found_and_takes_more_fresh_worlds(folder):
    before = read_diagnosis(folder)
    result = command("diagnose", folder)
    assert result.exit_code == 0, result.output
    assert before.sentence in result.stdout
    assert read_diagnosis(folder) == before
    printed = command("diagnose", folder, "--fresh", 80, "--json")
    more = json.loads(printed.stdout)
    assert before.fresh < more["fresh"] <= 80
    assert more["weaknesses"]
    assert all(one["inside"]["rate"] > one["outside"]["rate"] for one in more["weaknesses"])
    none = diagnose(folder, fresh=0)
    assert (none.fresh, none.weaknesses[0].inside) == (0, None)


def test_a_run_of_another_version_or_without_its_store_is_diagnosed_by_what_it_has(folder):
    kept = {name: (folder / name).read_bytes() for name in (RESULT_FILE, STORE_FILE)}
    data = json.loads(kept[RESULT_FILE])
    (folder / RESULT_FILE).write_text(json.dumps({**data, "of_tomorrow": 1}))
    assert diagnose(folder).worlds == 450
    (folder / STORE_FILE).unlink()
    (folder / DIAGNOSIS_FILE).unlink()
    for _ in range(2):
        with pytest.warns(Notice, match=r"run\.sqlite is missing or incomplete: .* finds less"):
            assert diagnose(folder).worlds == 50
    for name, content in kept.items():
        (folder / name).write_bytes(content)
    assert diagnose(folder).worlds == 450


def test_a_run_that_lost_its_queries_keeps_the_diagnosis_that_knew_them(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "copied")
    diagnose(copied)
    (copied / STORE_FILE).unlink()
    older = (copied / DIAGNOSIS_FILE).read_bytes()
    with pytest.warns(Notice, match="the older diagnosis is kept: it knew 450 worlds, and a new"):
        kept = diagnose(copied, fresh=80)
    assert kept.worlds == 450
    assert (copied / DIAGNOSIS_FILE).read_bytes() == older
    assert not (copied / STORE_FILE).exists()
    result = command("diagnose", copied, "--confirm", 2)
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith("run.sqlite is missing or incomplete, so the older")
    assert "Notice" not in result.stderr
    confirmed = read_diagnosis(copied)
    space = make_application("SADA-Analytic-v0").parameters
    mu = [failure.mu for failure in read_failures(copied).failures]
    tried = [holds(weakness.conditions, space, mu).any() for weakness in confirmed.weaknesses]
    assert any(tried)
    assert [weakness.confirmed is not None for weakness in confirmed.weaknesses] == tried
    assert (confirmed.worlds, confirmed.sentence) == (450, kept.sentence)
    (copied / DIAGNOSIS_FILE).write_text("{")  # damaged, so there is nothing to keep
    with pytest.warns(Notice, match="finds less"):
        assert diagnose(copied).worlds == 50


def test_a_run_without_failures_says_so(tmp_path):
    result = toy_attack(tmp_path / "run", Toy(offset=1.0), "random")
    assert result.diagnosis.sentence == "No world fooled the agent."
    assert result.diagnosis.weaknesses == ()
    told = [line.split(None, 1) for line in str(result).splitlines()]
    assert ["where", "No world fooled the agent."] in told


def test_bad_input_is_told_in_a_sentence(tmp_path, folder):
    with pytest.raises(FileError, match="Expected a folder that `sada-gym attack` wrote"):
        diagnose(tmp_path)
    with pytest.raises(UserError, match="Expected fresh of at least 0, got -1"):
        diagnose(folder, fresh=-1)
    toy_attack(tmp_path / "mine", Toy(), diagnose=False)
    assert diagnose(tmp_path / "mine", application=Toy()).worlds == 130
    with pytest.raises(UserError, match="application=YOURS"):
        diagnose(tmp_path / "mine", application=Toy(offset=0.1))
    missing = command("diagnose", tmp_path / "nowhere")
    assert missing.exit_code == 2
    assert "Traceback" not in missing.output
