import itertools
import json
import threading

import numpy as np
import pytest
from toy import Greedy, Toy
from toy_attacks import contents, run

from sada_gym import adversaries, attack
from sada_gym.errors import BudgetTooSmall
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.experiment.algorithm import RunProgress
from sada_gym.experiment.record import RunReport
from sada_gym.foundations.files import read_model
from sada_gym.oracle import evaluation_seeds
from sada_gym.run.folder import read_samples

LOCKED = type("Local", (Toy,), {"lock": threading.Lock()})()


def test_an_attack_writes_its_folder(tmp_path):
    reported = []
    result = run(tmp_path / "a" / "b", pictures=True, on_progress=reported.append)
    assert sorted(path.name for path in result.folder.iterdir()) == [
        "adversary",
        "attack.json",
        "diagnosis.json",
        "failures.json",
        "fooled.png",
        "influence.png",
        "influence.svg",
        "marginals.png",
        "report.html",
        "result.json",
        "run.sqlite",
        "samples.npz",
        "scores.png",
        "thumbnails.zip",
        "worlds.csv",
        "worlds.json",
    ]
    stages = [stage for stage, _ in itertools.groupby(progress.stage for progress in reported)]
    first = ["train", "learn", "train", "learn", "sample", "test", "measure"]
    assert stages == [*first, "diagnose", "pictures"]
    assert reported[0] == RunProgress("train", 0, 100, 0)
    assert RunProgress("train", 100, 100, 0, evaluated=100) in reported
    assert RunProgress("test", 30, 30, 0, evaluated=130) in reported
    assert [progress.evaluated for progress in reported if progress.stage == "measure"][-1] == 130
    report = read_model(result.folder / "result.json", RunReport)
    assert report == result.result
    samples = read_samples(result.folder / "samples.npz")
    np.testing.assert_array_equal(samples.mu, result.samples.mu)
    replayed = Toy().evaluate(samples.mu, samples.seed.tolist())
    np.testing.assert_array_equal(replayed.score, samples.score)
    assert report.afr == replayed.fooled.mean() == report.fooled / 30
    assert report.afr_interval_95[0] < report.afr <= report.afr_interval_95[1]
    assert report.search.queries == len(result.queries) == 100
    assert 0 < report.search.fooling_rate < report.afr
    assert 0 < report.novelty.minimum <= report.nearest_fooling_query.median
    assert report.settings.experiment.target.application.fingerprint == "toy"
    settings = report.settings.experiment.target.application.settings
    assert [*settings.pop("source_sha256")] == ["toy.py"]
    assert settings == {"dimension": 3, "offset": 0.0}
    assert report.settings.packages["numpy"] == np.__version__


def test_the_rate_over_feasible_worlds_is_reported_where_it_is_known(tmp_path):
    assert run(tmp_path / "unknown").result.feasible is None

    class Known(Toy):
        def privileged_score(self, mu, seeds):
            assert len(mu) == len(seeds) == 30
            return np.where(np.asarray(mu)[:, 0] > 0, 1.0, 0.0)

    result = attack(Known(), "random", samples=30, out=tmp_path / "known")
    worlds = result.samples.mu[:, 0] > 0
    fooled = result.samples.score <= 0.3
    rate = result.result.feasible
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


def test_a_run_that_fails_in_its_first_evaluation_leaves_nothing(tmp_path):
    class Broken(Toy):
        def evaluate_batch(self, mu, seeds):
            raise RuntimeError("the simulator crashed")

    for _ in range(2):
        with pytest.raises(RuntimeError, match="the simulator crashed"):
            attack(Broken(), "random", budget=0, samples=9, out=tmp_path / "new" / "run")
        assert list(tmp_path.iterdir()) == []


def test_the_application_says_how_many_samples(tmp_path):
    assert run(tmp_path, samples=None).result.settings.experiment.protocol.samples == 20


def test_no_budget_is_no_error_of_ours(tmp_path):
    class Idle(Greedy):
        name = "idle"

        def train(self, oracle):
            self.mean, self.std = np.zeros(3), np.ones(3)

    report = run(tmp_path, adversary=Idle, budget=0).result
    assert (report.novelty, report.nearest_fooling_query) == (None, None)
    assert report.search.fooling_rate is None


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"problem": lambda mu: mu[:, 0]}, TypeError, "dimension="),
        ({"budget": -1}, ValueError, "Expected budget of at least 0, got -1"),
        ({"samples": 0}, ValueError, "Expected samples of at least 1, got 0"),
        ({"adversary": 3}, TypeError, "Expected an adversary's name or class, got 3"),
        ({"preset": 3}, TypeError, "Expected a preset's name or None, got 3"),
        ({"options": [1]}, TypeError, r"Expected options by name, .*, got \[1\]"),
        ({"env_kwargs": {1: 2}}, TypeError, "Expected env_kwargs by name, .*, got {1: 2}"),
        ({"problem": Toy(agent_id=None)}, ValueError, "Expected a fingerprint"),
        ({"options": {"best": object()}}, TypeError, "can be written as JSON"),
        ({"options": {"bets": 3}}, TypeError, "bets"),
        ({"workers": 2, "problem": LOCKED}, TypeError, "can be pickled"),
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
    monkeypatch.setattr("sada_gym.attacks.OpenTarget", None)
    with pytest.raises(ValueError, match=message):
        attack(environment, adversary, env_kwargs=env_kwargs, out=tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


def test_a_result_prints_as_its_summary(tmp_path):
    result = run(tmp_path / "a", pictures=True)
    text = str(result)
    assert repr(result) == text
    lines = text.splitlines()
    assert lines[0] == "the agent in Toy-v0, attacked by greedy"
    assert "unknown for all worlds in the ranges" in lines[1]
    low, high = (100 * end for end in result.result.afr_interval_95)
    rate = f"{100 * result.result.afr:.0f} % of worlds that greedy makes ({low:.0f} to {high:.0f}"
    assert rate in lines[2]
    [weakness] = result.diagnosis.weaknesses
    where = next(line for line in lines if line.startswith("  where"))
    assert f"1. {weakness.text}"[:30] in where
    without = run(tmp_path / "b", diagnose=False)
    told = [line.split(None, 1)[0] for line in str(without).splitlines()]
    assert "where" not in told
    assert f"{tmp_path / 'a' / 'report.html'}" in text
    assert "sada_gym.replay(" in text, "no command opens what Python made"
    assert "array(" not in text


def test_the_headline_of_the_pictures_is_where_the_agent_fails(tmp_path, monkeypatch):
    asked = {}

    def draw(application, samples, queries, folder, *, headline, on_progress, on_frame):
        asked["headline"] = headline
        on_progress(1, 2)
        (folder / "sheet.png").write_bytes(b"new")
        return (folder / "sheet.png",)

    monkeypatch.setattr("sada_gym.analyses.plots.attack.draw_attack", draw)
    reported = []
    result = run(tmp_path, pictures=True, html=False, on_progress=reported.append)
    assert result.diagnosis is not None
    assert asked["headline"] == result.diagnosis.sentence != ""
    assert result.pictures == (tmp_path / "sheet.png",)
    assert reported[-2:] == [RunProgress("pictures"), RunProgress("pictures", 1, 2)]
    undiagnosed = run(tmp_path / "undiagnosed", pictures=True, html=False, diagnose=False)
    assert undiagnosed.diagnosis is None
    assert asked["headline"] == ""


def test_progress_is_shown_on_stderr_and_can_be_switched_off(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("sada_gym.experiment.progress.LINE_EVERY_S", 0.02)
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

    [flag] = run(tmp_path, adversary=Collapsed).result.flags
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
