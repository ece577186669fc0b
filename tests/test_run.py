"""The run as an object: what it reads, opens and refuses, and runs of the format before."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from toy import Toy

import sada_gym
from sada_gym import attack, load_run
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.errors import FileError, UserError
from sada_gym.run.folder import SETTINGS_FILE, read_record
from sada_gym.run.given import Given

STORED = Path(__file__).parent / "runs_of_format_1"
"""Attacks by gmm10 with 24 queries and 10 samples, seed 3, of 27 November 2026."""
ANALYTIC = "SADA-Analytic-v0"
SMALL = {"adversary": "gmm10", "budget": 24, "samples": 10, "seed": 3, "pictures": False}


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """The stored runs, beside the files that they were made of."""
    folder = shutil.copytree(STORED, tmp_path / "stored")
    (folder / "toml" / "application.txt").write_text(str(folder / "cartpole.toml"))
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    sys.modules.pop("pole", None)


def pole():
    from pole import AGENT

    return GymnasiumApplication(
        "CartPole-v1",
        agent=AGENT,
        agent_id="leaner",
        parameters={"gravity": (5.0, 15.0), "force_mag": (4.0, 16.0)},
        score=("length", 100),
        fooling_threshold=0.5,
    )


@pytest.mark.parametrize("by", ["id", "toml", "python"])
def test_a_run_of_the_format_before_is_read_and_opened(stored, by):
    run = load_run(stored / by)
    assert run.given.by == by
    assert (len(run.samples), len(run.queries)) == (10, 24)
    assert run.result.settings == run.settings
    assert run.diagnosis is not None
    with run.open(pole() if by == "python" else None) as opened:
        again = opened.application.evaluate(run.samples.mu, run.samples.seed.tolist())
    np.testing.assert_array_equal(again.score, run.samples.score)


def test_a_run_of_the_format_before_is_resumed_and_diagnosed(stored):
    settings = load_run(stored / "id").settings
    keywords = {"regions": 2, "volume": 0.3}
    record = json.loads((stored / "id" / SETTINGS_FILE).read_text())
    record["packages"] = attack(ANALYTIC, env_kwargs=keywords, **SMALL).settings.packages
    (stored / "id" / SETTINGS_FILE).write_text(json.dumps(record))
    (stored / "id" / "result.json").unlink()
    run = attack(ANALYTIC, env_kwargs=keywords, out=stored / "id", resume=True, **SMALL)
    assert run.settings.experiment == settings.experiment
    np.testing.assert_array_equal(run.samples.score, load_run(STORED / "id").samples.score)
    assert sada_gym.diagnose(run).worlds == 34


def test_what_was_given_is_recorded_and_opens_it_again(tmp_path):
    run = attack(ANALYTIC, env_kwargs={"volume": 0.3, "dimension": 3}, out=tmp_path, **SMALL)
    assert run.given == Given(by="id", id=ANALYTIC, keywords={"volume": 0.3, "dimension": 3})
    assert load_run(tmp_path).given == run.given == read_record(tmp_path).given
    with run.open(workers=1) as opened:
        assert opened.application.volume == 0.3
    with run.open_changed({"volume": 0.2}) as opened:
        assert (opened.application.volume, opened.dimension) == (0.2, 3)


def test_keywords_that_live_in_one_program_alone_are_handed_over():
    assert Given.of("SADA-Digits-3-v0", {"agent": object()}).by == "python"
    assert Given.of("SADA-Digits-3-v0", {"agent": Path("a.zip")}).keywords == {"agent": "a.zip"}
    assert Given.of(Toy(), {}) == Given(by="python")


def test_an_attack_returns_what_load_run_reads(tmp_path):
    run = attack(Toy(), out=tmp_path, **SMALL | {"pictures": True})
    read = load_run(tmp_path)
    assert repr(read) == repr(run)
    assert read.result == run.result
    assert read.html == tmp_path / "report.html"
    assert [path.name for path in read.files][:2] == ["report.html", "marginals.png"]
    assert attack(Toy(), out=tmp_path, resume=True, **SMALL).was_finished
    assert read.parameters.names == Toy().parameters.names


def test_without_a_folder_a_run_is_kept_as_long_as_it_is_used():
    run = attack(Toy(), **SMALL)
    folder = run.folder
    assert (folder / "result.json").is_file()
    del run
    assert not folder.parent.exists()


def test_the_worlds_are_a_table(tmp_path, monkeypatch):
    run = attack(Toy(), out=tmp_path, **SMALL)
    monkeypatch.setitem(sys.modules, "pandas", None)
    rows = run.worlds()
    assert len(rows) == 34
    assert [row["score"] for row in rows[:10]] == run.samples.score.tolist()
    assert {row["role"] for row in rows} == {"sample", "query"}
    (tmp_path / "worlds.csv").unlink()
    with pytest.raises(FileError, match="sada-gym report"):
        run.worlds()


def test_a_run_that_lost_its_queries_says_so(tmp_path):
    run = attack(Toy(), out=tmp_path, **SMALL)
    assert len(run.queries) == 24
    (tmp_path / "run.sqlite").unlink()
    assert load_run(tmp_path).queries is None


def test_another_application_and_no_run_are_refused(tmp_path):
    run = attack(Toy(), out=tmp_path / "run", **SMALL)
    with pytest.raises(UserError, match="hand it over: application=YOURS"):
        run.open()
    with pytest.raises(UserError, match=r"as it was attacked, got another"):
        run.open(sada_gym.make_application(ANALYTIC))
    with pytest.raises(FileError, match="Expected a folder that `sada-gym attack` wrote"):
        load_run(tmp_path)
    (tmp_path / "run" / "samples.npz").unlink()
    with pytest.raises(FileError, match="resume=True"):
        load_run(tmp_path / "run")
    (tmp_path / "run" / SETTINGS_FILE).write_text('{"format": 3}')
    with pytest.raises(FileError, match="format"):
        load_run(tmp_path / "run")


def test_the_names_at_the_top_are_what_they_say():
    assert callable(sada_gym.attack)
    assert callable(sada_gym.load_run)
    for name in sada_gym.__all__:
        assert getattr(sada_gym, name) is not None
