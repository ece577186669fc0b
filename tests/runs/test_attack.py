import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from toy import Greedy, Toy

from sada_gym import adversaries
from sada_gym.attack import RunProgress, attack
from sada_gym.errors import BudgetTooSmall
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.files import read_model
from sada_gym.oracle import evaluation_seeds
from sada_gym.runs.record import RunReport, read_samples

SETTINGS = {"budget": 100, "samples": 30, "seed": 3, "pictures": False}


def run(out, problem=None, adversary=Greedy, **settings):
    return attack(problem or Toy(), adversary, out=out, **{**SETTINGS, **settings})


def test_an_attack_writes_its_folder(tmp_path):
    reported = []
    result = run(tmp_path / "a" / "b", pictures=True, on_progress=reported.append)
    assert sorted(path.name for path in result.folder.iterdir()) == [
        "adversary",
        "attack.json",
        "fooled.png",
        "marginals.png",
        "result.json",
        "run.sqlite",
        "samples.npz",
        "scores.png",
    ]
    stages = [stage for stage, _ in itertools.groupby(one.stage for one in reported)]
    assert stages == ["train", "learn", "train", "learn", "sample", "test", "measure", "pictures"]
    assert reported[0] == RunProgress("train", 0, 100, 0)
    assert RunProgress("train", 100, 100, 0, evaluated=100) in reported
    assert RunProgress("test", 30, 30, 0, evaluated=130) in reported
    assert [one.evaluated for one in reported if one.stage == "measure"][-1] == 130
    report = read_model(result.folder / "result.json", RunReport)
    assert report == result.report
    samples = read_samples(result.folder / "samples.npz")
    np.testing.assert_array_equal(samples.mu, result.samples.mu)
    replayed = Toy().evaluate(samples.mu, samples.seed.tolist())
    np.testing.assert_array_equal(replayed.score, samples.score)
    assert report.afr == replayed.fooled.mean() == report.fooled / 30
    assert report.afr_interval_95[0] < report.afr <= report.afr_interval_95[1]
    assert report.search.queries == len(result.queries) == 100
    assert 0 < report.search.fooling_rate < report.afr
    assert 0 < report.novelty.minimum <= report.nearest_fooling_query.median
    assert report.settings.fingerprint == "toy"
    assert report.settings.application_settings == {"dimension": 3, "offset": 0.0}
    assert report.settings.packages["numpy"] == np.__version__


def test_the_rate_over_feasible_worlds_is_reported_where_it_is_known(tmp_path):
    assert run(tmp_path / "unknown").report.feasible is None

    class Known(Toy):
        def feasible(self, mu, seeds):
            assert len(mu) == len(seeds) == 30
            return np.asarray(mu)[:, 0] > 0

    result = attack(Known(), "random", samples=30, out=tmp_path / "known")
    worlds = result.samples.mu[:, 0] > 0
    fooled = result.samples.score <= 0.3
    rate = result.report.feasible
    assert 0 < rate.fooled < rate.worlds < 30
    assert (rate.worlds, rate.fooled) == (worlds.sum(), (worlds & fooled).sum())
    assert rate.afr == rate.fooled / rate.worlds


def test_test_samples_see_seeds_that_training_never_used(tmp_path):
    result = run(tmp_path)
    assert result.queries.seed.tolist() == evaluation_seeds(3, "train", 0, 100)
    assert result.samples.seed.tolist() == evaluation_seeds(3, "test", 0, 30)
    assert not set(result.queries.seed) & set(result.samples.seed)


def test_the_same_seed_gives_the_same_files_and_another_another(tmp_path):
    for name, seed, workers in (("a", 3, 1), ("b", 3, 2), ("c", 4, 1)):
        run(tmp_path / name, seed=seed, workers=workers)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert contents(tmp_path / "a") != contents(tmp_path / "c")


def contents(folder):
    """Give all files but the store, whose bytes depend on the order in which chunks came."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "run.sqlite"
    }


def test_a_run_that_fails_in_its_first_evaluation_leaves_nothing(tmp_path):
    class Broken(Toy):
        def _evaluate(self, mu, seeds):
            raise RuntimeError("the simulator crashed")

    for _ in range(2):
        with pytest.raises(RuntimeError, match="the simulator crashed"):
            attack(Broken(), "random", budget=0, samples=9, out=tmp_path / "new" / "run")
        assert list(tmp_path.iterdir()) == []


def test_the_application_says_how_many_samples(tmp_path):
    assert run(tmp_path, samples=None).report.settings.samples == 20


def test_no_budget_is_no_error_of_ours(tmp_path):
    class Idle(Greedy):
        name = "idle"

        def train(self, oracle):
            self.mean, self.std = np.zeros(3), np.ones(3)

    report = run(tmp_path, adversary=Idle, budget=0).report
    assert (report.novelty, report.nearest_fooling_query) == (None, None)
    assert report.search.fooling_rate is None


def test_a_folder_with_a_run_is_refused_and_left_alone(tmp_path):
    run(tmp_path)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=r"which holds a run.*--resume"):
        run(tmp_path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"budget": 200}, "budget was 100 and is 200"),
        ({"seed": 4}, "seed was 3 and is 4"),
        ({"options": {"best": 5}}, "options.best was None and is 5"),
        ({"problem": Toy(offset=0.1)}, "application_settings.offset was 0.0 and is 0.1"),
        ({"problem": Toy(agent_id="new")}, "fingerprint was 'toy' and is 'new'"),
        ({"problem": Toy(version=1)}, "version was 0 and is 1"),
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


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"problem": lambda mu: mu[:, 0]}, TypeError, "dimension="),
        ({"budget": -1}, ValueError, "Expected budget of at least 0, got -1"),
        ({"samples": 0}, ValueError, "Expected samples of at least 1, got 0"),
        ({"adversary": 3}, TypeError, "Expected an adversary's name or class, got 3"),
        ({"problem": Toy(agent_id=None)}, ValueError, "Expected a fingerprint"),
        ({"options": {"best": object()}}, TypeError, "can be written as JSON"),
        ({"options": {"bets": 3}}, TypeError, "bets"),
        ({"workers": 2, "problem": type("Local", (Toy,), {})()}, TypeError, "can be pickled"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_written(tmp_path, settings, error, message):
    with pytest.raises(error, match=message):
        run(tmp_path / "new", **settings)
    assert not (tmp_path / "new").exists()


def test_no_path_is_refused_in_a_sentence():
    with pytest.raises(TypeError, match="Expected the path of the folder for the results, got 5"):
        run(5)
    with pytest.raises(ValueError, match="its name holds a NUL"):
        run("a\0b")


class Hungry(Greedy):
    """Refuses small budgets, before or after its first queries."""

    name = "hungry"

    def __init__(self, dimension, *, seed=None, after=0):
        super().__init__(dimension, seed=seed)
        self.after = after

    def train(self, oracle):
        if self.after:
            oracle(np.zeros((self.after, self.dimension)))
        raise BudgetTooSmall(f"Expected a budget of at least 1,000, got {oracle.remaining}.")


def test_a_refused_run_leaves_nothing_behind(tmp_path):
    with pytest.raises(ValueError, match="at least 1,000, got 100"):
        run(tmp_path / "a" / "b", adversary=Hungry)
    assert list(tmp_path.iterdir()) == []
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="at least 1,000, got 100"):
        run(mine, adversary=Hungry)
    assert [path.name for path in mine.iterdir()] == ["notes.txt"]
    run(mine)


@pytest.mark.parametrize("name", sorted({*adversaries.names()} - {"random"}))
def test_all_but_the_controls_refuse_a_budget_of_0(tmp_path, name):
    with pytest.raises(ValueError, match="Expected a budget of at least"):
        run(tmp_path / "a", adversary=name, budget=0)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_later_keeps_its_evaluations(tmp_path):
    with pytest.raises(ValueError, match="at least 1,000, got 97"):
        run(tmp_path / "a", adversary=Hungry, options={"after": 3})
    with EvaluationStore(tmp_path / "a" / "run.sqlite") as store:
        assert len(store) == 3
    with pytest.raises(ValueError, match="at least 1,000, got 97"):
        run(tmp_path / "a", adversary=Hungry, options={"after": 3}, resume=True)
    assert (tmp_path / "a" / "attack.json").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_world_that_breaks_at_once_leaves_nothing_behind(tmp_path, workers):
    with pytest.raises(RuntimeError, match="the world collapsed"):
        run(tmp_path / "a", Toy(fail_above=-2.0), workers=workers)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("environment", "adversary", "env_kwargs", "message"),
    [
        ("SADA-Detecton-v0", "random", {}, "Did you mean 'SADA-Detection-v0'"),
        ("SADA-Detection-v0", "randm", {}, "Did you mean random"),
        ("SADA-Detection-v0", "random", {"agent": "nofile.pt"}, "got nofile.pt: no such file"),
        ("SADA-Detection-v0", "random", {"agent": "photografer"}, "Did you mean 'photographer'"),
    ],
)
def test_misspelt_names_are_told_before_anything_is_made(
    tmp_path, monkeypatch, environment, adversary, env_kwargs, message
):
    monkeypatch.setattr("sada_gym.attack.Evaluator", None)
    with pytest.raises(ValueError, match=message):
        attack(environment, adversary, env_kwargs=env_kwargs, out=tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


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
    assert again.report == first.report
    for one, other in ((first.samples, again.samples), (first.queries, again.queries)):
        np.testing.assert_array_equal(one.mu, other.mu)
        np.testing.assert_array_equal(one.score, other.score)
        np.testing.assert_array_equal(one.seed, other.seed)
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
    assert {one.stage for one in reported} == {"pictures"}
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


def test_a_result_of_an_earlier_version_is_read(tmp_path):
    first = run(tmp_path)
    path = tmp_path / "result.json"
    report = json.loads(path.read_text())
    del report["where"]
    path.write_text(json.dumps(report))
    assert read_model(path, RunReport).where is None
    again = run(tmp_path, resume=True)
    assert again.was_finished
    assert again.report == first.report


def test_a_result_prints_as_its_summary(tmp_path):
    result = run(tmp_path / "a", pictures=True)
    text = str(result)
    assert repr(result) == text
    lines = text.splitlines()
    assert lines[0] == "Toy-v0 · greedy"
    low, high = (100 * end for end in result.report.afr_interval_95)
    assert f"{100 * result.report.afr:.1f} % (95 % interval {low:.1f} to {high:.1f})" in lines[1]
    assert lines[2].split(None, 1) == ["where", result.report.where.sentence]
    assert "uniform worlds        not known" in text
    assert f"novelty               median distance {result.report.novelty.median:.3f} " in text
    assert lines[-1].startswith(f"Results: {tmp_path / 'a'}/ (result.json, marginals.png")
    assert "array(" not in text


def test_the_headline_of_the_pictures_is_where_the_agent_fails(tmp_path, monkeypatch):
    asked = {}

    def draw(application, samples, queries, folder, *, headline, on_progress):
        asked["headline"] = headline
        on_progress(1, 2)
        (folder / "sheet.png").write_bytes(b"new")
        return (folder / "sheet.png",)

    monkeypatch.setattr("sada_gym.plots.attack.draw_attack", draw)
    reported = []
    result = run(tmp_path, pictures=True, on_progress=reported.append)
    assert asked["headline"] == result.report.where.sentence != ""
    assert result.pictures == (tmp_path / "sheet.png",)
    assert reported[-2:] == [RunProgress("pictures"), RunProgress("pictures", 1, 2)]


def test_pictures_that_fail_can_be_drawn_later(tmp_path, monkeypatch):
    def fail(application, samples, queries, folder, **_):
        (folder / "half.png").write_bytes(b"half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("sada_gym.plots.attack.draw_attack", fail)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path, pictures=True)
    assert not list(tmp_path.rglob("*.png"))
    done = run(tmp_path, pictures=True, resume=True)
    assert done.was_finished
    assert len(done.pictures) == 3


def test_progress_is_shown_on_stderr_and_can_be_switched_off(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("sada_gym.cli.progress.LINE_EVERY_S", 0.02)
    slow = Toy(pause_s=0.002)
    run(tmp_path / "a", slow)
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "Querying: " in printed.err
    run(tmp_path / "b", slow, progress=False)
    run(tmp_path / "c", slow, on_progress=lambda now: None)
    assert capfd.readouterr() == ("", "")


def test_the_steps_of_learning_are_reported(tmp_path):
    reported = []
    options = {"steps": 7, "batch": 16, "generator": (16,), "discriminator": (16,)}
    run(tmp_path, adversary="bbgan", options=options, on_progress=reported.append)
    assert RunProgress("learn", 7, 7, 0, evaluated=100) in reported


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ValueError, match="got the file"):
        run(tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_collapsed_sampler_is_flagged(tmp_path):
    class Collapsed(Greedy):
        def sample(self, n):
            return np.full((n, 3), 0.2, np.float32)

    [flag] = run(tmp_path, adversary=Collapsed).report.flags
    assert "nearly one point" in flag


def test_flags_with_control_characters_are_refused(tmp_path):
    run(tmp_path)
    path = tmp_path / "result.json"
    report = json.loads(path.read_text()) | {"flags": ["\x1b[2J"]}
    path.write_text(json.dumps(report))
    with pytest.raises(ValueError, match=r"flags\.0: .* control characters"):
        read_model(path, RunReport)


def test_the_ideal_needs_a_reference_set(tmp_path):
    with pytest.raises(ValueError, match="Expected ideal on a track that has a reference set"):
        attack(Toy(), "ideal", out=tmp_path / "toy")
    assert not (tmp_path / "toy").exists()


def test_too_few_samples_are_the_adversarys_fault(tmp_path):
    class Short(Greedy):
        name = "short"

        def sample(self, n):
            return super().sample(n)[1:] if n == 30 else super().sample(n)

    with pytest.raises(ValueError, match=r"shape \(30, 3\) from Short.sample, got \(29, 3\)"):
        run(tmp_path, adversary=Short)


SCRIPT = """
import sys
from toy import Greedy, Toy
from sada_gym.attack import attack
out, log, resume = sys.argv[1], sys.argv[2], sys.argv[3] == "resume"
adversary = sys.argv[4] or Greedy
attack(Toy(pause_s=0.004, log=log), adversary, out=out, budget=300, samples=30, workers=2,
       chunk_size=10, resume=resume, pictures=False)
"""


def start(out, log, adversary, how="anew"):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", SCRIPT, str(out), str(log), how, adversary]
    return subprocess.Popen(command, env=environment)


def logged(log):
    """Give the (process, seed) pairs of a log; its last line may be incomplete."""
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
    assert len(committed) + len(again) == 330

    assert start(tmp_path / "whole", tmp_path / "third.log", adversary).wait() == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["afr"] > 0
