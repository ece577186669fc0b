"""No more environments are alive in a process than `num_envs` allows, and no score changes."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO
from typer.testing import CliRunner

import tests.support.one_engine as toys
from sada_gym import attack
from sada_gym.cli import app
from sada_gym.envs.wrapped import Attribute, Function, inspection
from sada_gym.errors import Notice, UserError
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.files import read_toml
from sada_gym.testing.check import check_application
from tests.support.one_engine import OneEngine, one_engine

MU = np.random.default_rng(0).uniform(-1, 1, (5, 2)).astype(np.float32)
TOML = """
environment = "tests.support.one_engine:OneEngine-v0"
agent = "tests.support.one_engine:hold"
agent_id = "hold"
score = ["return", -5.0, 0.0]
fooling_threshold = 0.5
num_envs = 1
[parameters]
mass = [1.0, 4.0]
slope = [0.0, 0.3]
[derived]
weight = "mass * 9.81"
"""


@pytest.fixture(autouse=True)
def no_engine(monkeypatch):
    """Count the engines of one test."""
    monkeypatch.setattr(toys, "ALIVE", [])
    monkeypatch.setattr(toys, "most_alive", 0)


@pytest.mark.parametrize("late", [False, True], ids=["constructor", "reset"])
@pytest.mark.parametrize("second", ["raises", "hangs"])
def test_a_second_engine_that_fails_is_told_by_what_fixes_it(second, late, monkeypatch):
    monkeypatch.setattr(inspection, "_PATIENCE_S", 0.3)
    with pytest.raises(UserError, match=r"one alone works\. Set num_envs=1 \(num_envs = 1 in TOML"):
        one_engine(second, late=late)
    assert not toys.ALIVE
    one_engine(second, late=late, num_envs=1)


def test_an_environment_that_fails_alone_is_not_told_so():
    with pytest.raises(UserError, match=r"'slope' to set 0.0, got ValueError: too steep") as caught:
        one_engine(parameters={"slope": Function(0.0, 1.0, set=refuse)}, derived=None)
    assert "num_envs" not in str(caught.value)


def refuse(env, value):
    raise ValueError("too steep")


@pytest.mark.parametrize("episodes", [1, 3])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_all_that_an_application_does_keeps_to_the_limit_with_the_same_bits(num_envs, episodes):
    def answers(application):
        score = application.evaluate(MU, range(5))
        frames, replayed = application.replay(MU[1], 1)
        takes, filmed = application.takes(MU[1], 1)
        return [
            score.score,
            score.infos,
            application.behaviours(MU, range(5)),
            application.privileged_score(MU, range(5)),
            frames,
            replayed,
            [take.draw(take.count - 1) for take in takes],
            filmed,
            application.render(MU[2], 2),
            application.observation(MU[2], 2),
            [rollout["return"] for rollout in application.rollouts(MU[3], 3)],
            application.nominal,
            application.stale,
        ]

    settings = {"episodes": episodes, "privileged": lambda seen: [-2 * seen[0]]}
    limited = answers(one_engine("allowed", num_envs=num_envs, **settings))
    assert toys.most_alive == num_envs
    free = answers(one_engine("allowed", **settings))
    assert toys.most_alive > 2
    assert repr(limited) == repr(free)


def test_a_network_answers_the_same_for_one_environment_as_for_many():
    agent = PPO("MlpPolicy", OneEngine(second="allowed"), seed=0, device="cpu")
    options = {"agent": agent, "deterministic": False}
    one, many = (
        one_engine("allowed", num_envs=count, **options).evaluate(MU, range(5)).infos
        for count in (1, None)
    )
    assert one == many


def test_what_does_not_follow_is_found_one_world_after_another():
    with pytest.warns(Notice, match=r"weight was computed in the constructor"):
        found = one_engine(derived=None, num_envs=1)
    assert found.stale == {"weight": "mass * 9.81"}
    assert toys.most_alive == 1


def test_what_two_environments_share_is_found_one_after_another(monkeypatch):
    drag = {"drag": Attribute(0.5, 2.0, factor=True)}
    one_engine(parameters=drag, derived=None, num_envs=1)
    assert toys.most_alive == 1
    shared = np.array([0.1, 0.2])
    monkeypatch.setattr(OneEngine, "reset", sharing(OneEngine.reset, shared))
    with pytest.raises(UserError, match=r"a 'drag' of its own.*two share it"):
        one_engine(parameters=drag, derived=None, num_envs=1)


def sharing(reset, shared):
    def shares(self, **kwargs):
        self.drag = shared
        return reset(self, **kwargs)

    return shares


@pytest.mark.long
def test_the_contract_holds_with_one_engine():
    report = check_application(one_engine(num_envs=1))
    assert report.passed, report
    assert toys.most_alive == 1


def test_the_command_line_makes_and_checks_a_file_for_one_engine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    where = ["tests.support.one_engine:OneEngine-v0", "--agent", "tests.support.one_engine:hold"]
    result = CliRunner().invoke(app, ["init", *where, "--out", "one.toml"])
    assert result.exit_code == 0, result.output
    assert read_toml(tmp_path / "one.toml")["num_envs"] == 1
    (tmp_path / "own.toml").write_text(TOML)
    result = CliRunner().invoke(app, ["check", "own.toml"])
    assert result.exit_code == 0, result.output
    assert toys.most_alive == 1


@pytest.mark.long
def test_workers_have_one_engine_each_and_a_resumed_run_the_same_bits(tmp_path):
    settings = {"budget": 40, "samples": 12, "seed": 0}
    alone = attack(one_engine(num_envs=1), "gaussian", out=tmp_path / "a", **settings)
    free = attack(one_engine("allowed"), "gaussian", out=tmp_path / "b", **settings)
    two = attack(one_engine(num_envs=1), "gaussian", out=tmp_path / "c", workers=2, **settings)
    again = attack(one_engine(num_envs=1), "gaussian", out=tmp_path / "a", resume=True, **settings)
    for run in (free, two, again):
        assert (run.samples.score == alone.samples.score).all()


@pytest.mark.parametrize("bad", [0, -1, 1.5, "1", True])
def test_num_envs_that_is_no_count_gets_a_sentence(bad):
    with pytest.raises(UserError, match=r"num_envs"):
        one_engine(num_envs=bad)


class External(OneEngine):
    """Its engine is another process, as of CARLA; in heavy worlds it hangs."""

    def __init__(self, engines):
        super().__init__(second="allowed")
        self.process = subprocess.Popen(["sleep", "600"])
        (Path(engines) / str(self.process.pid)).touch()

    def step(self, action):
        if self.mass > 3.5:
            time.sleep(600)
        return super().step(action)

    def close(self):
        self.process.kill()
        self.process.wait()
        super().close()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_the_engine_of_a_killed_worker_is_not_left_running(tmp_path, monkeypatch):
    monkeypatch.setattr(toys, "OneEngine", External)
    application = one_engine(
        parameters={"mass": (1.0, 4.0)},
        env_kwargs={"engines": str(tmp_path)},
        num_envs=1,
        timeout=2.0,
    )
    with Oracle(application, budget=6, workers=2) as oracle:
        oracle(np.linspace(-1, 1, 6, dtype=np.float32)[:, None])
        assert oracle.invalid == {5: "it took longer than 2 s"}
    engines = [int(path.name) for path in tmp_path.iterdir()]
    assert len(engines) > 6
    assert not any(map(is_alive, engines))


def is_alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
