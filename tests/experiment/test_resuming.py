"""A folder that holds a run: what is refused, read, gone on with and made anew."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from spending import spent_after_samples
from toy import Greedy, Toy
from toy_attacks import contents, run

from sada_gym import attack
from sada_gym.errors import FileError
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.experiment.record import RunReport
from sada_gym.foundations.files import read_model


def test_a_folder_with_a_run_is_refused_and_left_alone(tmp_path):
    run(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=r"which holds a run.*--resume"):
        run(tmp_path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"budget": 200}, "protocol.budget was 100 and is 200"),
        ({"seed": 4}, "experiment.seed was 3 and is 4"),
        ({"options": {"best": 5}}, "adversary.options.best was None and is 5"),
        ({"problem": Toy(offset=0.1)}, "target.application.settings.offset was 0.0 and is 0.1"),
        ({"problem": Toy(agent_id="new")}, "application.fingerprint was 'toy' and is 'new'"),
        ({"problem": Toy(version=1)}, "application.version was 0 and is 1"),
    ],
)
def test_resuming_with_other_settings_is_refused(tmp_path, change, message):
    run(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=f"{message}.*Give the same ones, or name another folder"):
        run(tmp_path, resume=True, **change)
    assert contents(tmp_path) == before


def test_resuming_where_nothing_is_starts(tmp_path):
    run(tmp_path / "a", resume=True)
    run(tmp_path / "b")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_resuming_a_finished_run_evaluates_nothing(tmp_path):
    run(tmp_path, Toy(log=str(tmp_path / "log")))
    before = contents(tmp_path)
    run(tmp_path, Toy(log=str(tmp_path / "log")), resume=True)
    assert contents(tmp_path) == before


def test_results_without_settings_are_refused(tmp_path):
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(ValueError, match=r"got result.json in it without the attack.json"):
        run(tmp_path, resume=True)
    assert os.listdir(tmp_path) == ["result.json"]


@pytest.mark.parametrize("text", ["{", '{"budget": 1}', "[]"])
def test_damaged_settings_are_refused(tmp_path, text):
    (tmp_path / "attack.json").write_text(text)
    with pytest.raises(ValueError, match=r"Expected .*attack.json as sada-gym writes it"):
        run(tmp_path, resume=True)


def test_a_finished_run_is_read_and_not_done_again(tmp_path):
    first = run(tmp_path, pictures=True)
    before = contents(tmp_path)
    reported = []

    class Never(Greedy):
        def train(self, oracle):
            raise AssertionError("it trains again")

    Never.name = "greedy"
    again = run(tmp_path, adversary=Never, resume=True, pictures=True, on_progress=reported.append)
    assert (first.was_finished, again.was_finished) == (False, True)
    assert reported == []
    assert again.result == first.result
    for rows, other in ((first.samples, again.samples), (first.queries, again.queries)):
        np.testing.assert_array_equal(rows.mu, other.mu)
        np.testing.assert_array_equal(rows.score, other.score)
        np.testing.assert_array_equal(rows.seed, other.seed)
    assert again.pictures == tuple(sorted(first.pictures))
    assert contents(tmp_path) == before


def test_a_finished_run_without_queries_is_read(tmp_path):
    for was_finished in (False, True):
        done = attack(Toy(), "random", samples=10, out=tmp_path, pictures=False, resume=True)
        assert done.was_finished == was_finished
        assert done.queries.mu.shape == (0, 3)


def test_only_the_pictures_are_made_where_only_they_are_missing(tmp_path):
    run(tmp_path)
    reported = []
    done = run(tmp_path, resume=True, pictures=True, on_progress=reported.append)
    assert done.was_finished
    assert {progress.stage for progress in reported} == {"pictures"}
    assert (tmp_path / "fooled.png") in done.pictures
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("name", ["result.json", "samples.npz", "run.sqlite", "adversary"])
def test_what_is_missing_from_a_finished_run_is_made_anew(tmp_path, name):
    run(tmp_path)
    before = contents(tmp_path)
    path = tmp_path / name
    path.rename(tmp_path.parent / f"{tmp_path.name}-{name}")
    assert not run(tmp_path, resume=True).was_finished
    assert contents(tmp_path) == before


def test_a_damaged_result_is_made_anew(tmp_path):
    run(tmp_path)
    before = contents(tmp_path)
    (tmp_path / "result.json").write_text("{")
    assert not run(tmp_path, resume=True).was_finished
    assert contents(tmp_path) == before


def test_a_run_of_an_earlier_version_is_refused_and_left_alone(tmp_path):
    run(tmp_path)
    path = tmp_path / "attack.json"
    settings = json.loads(path.read_text())
    path.write_text(json.dumps({**settings["settings"]["experiment"]["target"], "label": "greedy"}))
    before = path.read_bytes()
    with pytest.raises(FileError, match=r"Expected .*attack\.json as sada-gym writes it"):
        run(tmp_path, resume=True)
    assert path.read_bytes() == before
    assert (tmp_path / "result.json").exists()


def test_a_finished_run_with_a_damaged_result_makes_it_again(tmp_path):
    first = run(tmp_path)
    path = tmp_path / "result.json"
    report = json.loads(path.read_text())
    del report["flags"]
    path.write_text(json.dumps(report))
    again = run(tmp_path, resume=True)
    assert not again.was_finished
    assert again.result == first.result == read_model(path, RunReport)


def test_pictures_that_fail_can_be_drawn_later(tmp_path, monkeypatch):
    def fail(application, samples, queries, folder, **_):
        (folder / "half.png").write_bytes(b"half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("sada_gym.analyses.plots.attack.draw_attack", fail)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, pictures=True)
    assert not list(tmp_path.rglob("*.png"))
    done = run(tmp_path, pictures=True, resume=True)
    assert done.was_finished
    assert len(done.pictures) == 4


@pytest.mark.long
def test_pictures_are_a_set_all_or_none(tmp_path, monkeypatch):
    replace = Path.replace

    def stop_at_the_second(path, place):
        if path.suffix == ".png" and list(tmp_path.glob("*.png")):
            raise KeyboardInterrupt
        return replace(path, place)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", stop_at_the_second)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, pictures=True)
    assert len(list(tmp_path.glob("*.png"))) == 1
    done = run(tmp_path, pictures=True, resume=True)
    assert done.was_finished
    assert len(done.pictures) == 4
    assert not list(tmp_path.glob(".*"))


@pytest.mark.long
def test_files_that_a_loss_of_power_left_empty_are_made_again(tmp_path):
    run(tmp_path, pictures=True)
    before = contents(tmp_path)
    (tmp_path / "fooled.png").write_bytes(b"")
    assert run(tmp_path, pictures=True, resume=True).was_finished
    saved = next(path for path in (tmp_path / "adversary").iterdir() if path.stat().st_size)
    saved.write_bytes(b"")
    assert not run(tmp_path, pictures=True, resume=True).was_finished
    assert contents(tmp_path) == before


class Meddled(Greedy):
    """An adversary during whose training something changes the run's folder."""

    name = "greedy"
    meddle = staticmethod(lambda: None)

    def train(self, oracle):
        super().train(oracle)
        self.meddle()


@pytest.mark.parametrize("name", ["attack.json", "run.sqlite", "all"])
def test_a_folder_that_is_removed_or_taken_over_during_a_run_is_noticed(tmp_path, name):
    folder, other = tmp_path / "run", tmp_path / "other"
    run(other, budget=50)

    def meddle():
        for file in ("attack.json", "run.sqlite"):
            if name in (file, "all"):
                (folder / file).unlink()
                (folder / file).write_bytes((other / file).read_bytes())

    Meddled.meddle = staticmethod(meddle)
    with pytest.raises(FileError, match="as this run left it, got changes"):
        run(folder, adversary=Meddled)
    assert not (folder / "result.json").exists()
    assert not (folder / "adversary").exists()


SCRIPT = """
import sys
from toy import Greedy, Toy
from sada_gym import Workers, attack
out, log, resume = sys.argv[1], sys.argv[2], sys.argv[3] == "resume"
adversary = sys.argv[4] or Greedy
attack(Toy(pause_s=0.004, log=log), adversary, out=out, budget=300, samples=30,
       workers=Workers(2, chunk_size=10), resume=resume, pictures=False)
"""


def start(out, log, adversary, how="anew"):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", SCRIPT, str(out), str(log), how, adversary]
    return subprocess.Popen(command, env=environment)


def logged(log):
    """Return the (process, seed) pairs of a log; its last line may be incomplete."""
    if not log.exists():
        return []
    return [
        tuple(map(int, line.split()))
        for line in log.read_text().splitlines(keepends=True)
        if line.endswith("\n")
    ]


def wait_for(condition, limit_s=60.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def is_alive(process):
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    "adversary",
    [pytest.param("", id="greedy"), pytest.param("ppo", marks=pytest.mark.slow)],
)
def test_killed_and_resumed_it_repeats_nothing_and_ends_the_same(tmp_path, adversary):
    first, second = tmp_path / "first.log", tmp_path / "second.log"
    process = start(tmp_path / "out", first, adversary)
    wait_for(lambda: len(logged(first)) > 100)
    process.send_signal(signal.SIGKILL)
    process.wait()
    workers = {worker for worker, _ in logged(first)}
    wait_for(lambda: not any(map(is_alive, workers)), limit_s=10)

    with EvaluationStore(tmp_path / "out" / "run.sqlite") as store:
        rows = store._connection.execute("SELECT seed FROM evaluation").fetchall()
    committed = {seed for (seed,) in rows}
    assert 50 < len(committed) < 330

    assert start(tmp_path / "out", second, adversary, "resume").wait() == 0
    again = [seed for _, seed in logged(second)]
    assert not committed & set(again)
    assert len(committed) + len(again) == 330 + sum(spent_after_samples(tmp_path / "out"))

    assert start(tmp_path / "whole", tmp_path / "third.log", adversary).wait() == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["afr"] > 0
