"""Worlds that break are told apart from failures of the agent."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import numpy as np
import pytest
import torch

import tests.support.breaking_worlds as toys
from sada_gym import GymnasiumApplication, attack
from sada_gym.application import INVALID_SCORE
from sada_gym.envs.wrapped.episodes import MEMORY_BYTES
from sada_gym.errors import StoreError, UserError, WorkerError
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import evaluation_seeds
from sada_gym.testing.check import check_application
from tests.support.breaking_worlds import breaking, one_that_breaks, uniform

FAULTS = ("raises", "exits", "nan reward", "nan observation", "memory", "silent")


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("where", ["reset", "step"])
def test_a_world_that_breaks_is_invalid_and_harms_no_other(fault, where):
    application = breaking(fault, where=where)
    mu = uniform(40)
    bad = toys.breaks(application.parameters.physical(mu)[:, 0])
    outcomes = application.evaluate(mu, range(40))
    assert 0 < bad.sum() < 20
    assert [*outcomes.invalid] == np.flatnonzero(bad).tolist()
    assert (outcomes.score[bad] == INVALID_SCORE).all()
    assert not outcomes.fooled[bad].any()
    healthy = breaking("none").evaluate(mu, range(40))
    assert (outcomes.score[~bad] == healthy.score[~bad]).all()
    if where == "step":
        assert toys.REASONS[fault] in outcomes.infos[int(np.flatnonzero(bad)[0])]["invalid"]


def test_a_broken_world_may_count_as_a_failure_or_raise():
    mu = uniform(40)
    bad = breaking("raises").evaluate(mu, range(40)).invalid
    fooled = breaking("raises", on_error="fooled").evaluate(mu, range(40))
    assert not fooled.invalid
    assert fooled.fooled[[*bad]].all()
    with pytest.raises(
        UserError, match=r"a step with \{'mass': .*RuntimeError: unstable at 0x\.\.\."
    ):
        breaking("raises", on_error="raise").evaluate(mu, range(40))


def test_nan_is_normal_where_the_environment_always_shows_it():
    application = breaking("nan always")
    assert not application.evaluate(uniform(9), range(9)).invalid


def test_an_agents_own_errors_are_no_invalid_worlds():
    def lost(seen):
        raise RuntimeError("no plan")

    with pytest.raises(
        UserError, match=r"an action from push at step 0 .*, got RuntimeError: no plan"
    ):
        breaking("none", agent=lost).evaluate(uniform(1), [0])


def test_replays_of_a_broken_world_have_its_score():
    application = breaking("raises")
    mu = uniform(40)
    row = next(iter(application.evaluate(mu, range(40)).invalid))
    frames, score = application.replay(mu[row], row)
    assert score == INVALID_SCORE
    assert len(frames) >= 1
    assert application.render(mu[row], row).ndim == 3


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_an_attack_goes_on_and_tells_and_resumes_with_the_same_result(tmp_path, workers):
    settings = {"budget": 60, "samples": 20, "pictures": False, "progress": False}

    result = attack(breaking("raises"), "gaussian", out=tmp_path / "a", workers=workers, **settings)
    again = attack(breaking("raises"), "gaussian", out=tmp_path / "b", workers=1, **settings)
    invalid = result.result.invalid
    assert invalid == again.result.invalid
    assert invalid.queries == result.queries.invalid.sum() > 0
    assert "RuntimeError: unstable at 0x..." in invalid.reason
    assert toys.breaks(invalid.parameters["mass"])
    assert "no failures of the agent" in str(result)
    for name in ("result.json", "samples.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    (tmp_path / "a" / "result.json").unlink()
    resumed = attack(
        breaking("raises"), "gaussian", out=tmp_path / "a", resume=True, workers=1, **settings
    )
    assert resumed.result == result.result
    assert (resumed.queries.invalid == result.queries.invalid).all()
    finished = attack(
        breaking("raises"), "gaussian", out=tmp_path / "a", resume=True, workers=1, **settings
    )
    assert finished.was_finished
    assert (finished.queries.invalid == result.queries.invalid).all()


def test_the_rate_is_over_samples_in_valid_worlds(tmp_path):
    result = attack(
        breaking("raises"),
        "random",
        out=tmp_path / "run",
        budget=0,
        samples=60,
        pictures=False,
        progress=False,
    )
    valid = ~result.samples.invalid
    assert 0 < valid.sum() < 60
    assert result.result.afr == result.samples.fooled(0.5)[valid].mean()
    assert result.result.fooled == result.samples.fooled(0.5).sum()
    assert f", {valid.sum()} worlds)" in str(result)


def test_too_many_invalid_worlds_end_the_attack_with_advice(tmp_path):
    application = breaking("raises", low=1.75)
    with pytest.raises(
        UserError, match=r"at most 20% invalid worlds, got \d+ of \d+\. One has mass"
    ):
        attack(application, "gaussian", out=tmp_path, budget=60, samples=20, progress=False)


def test_a_store_of_before_opens_and_keeps_its_scores(tmp_path):
    path = tmp_path / "run.sqlite"
    mu = uniform(40)
    with Oracle(breaking("none"), budget=40, store=path) as oracle:
        scores = oracle(mu)
    with closing(sqlite3.connect(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    assert "invalid" not in tables  # as it was before worlds could be invalid
    with Oracle(breaking("none"), budget=40, store=path) as oracle:
        assert (oracle(mu) == scores).all()
        assert oracle.invalid == {}


@pytest.mark.long
def test_a_worker_that_dies_in_one_world_costs_that_world_alone(tmp_path):
    fault = "segfault"
    mu = one_that_breaks()
    seeds = evaluation_seeds(0, "train", 0, 12)
    bad = breaking("raises").evaluate(mu, seeds).invalid
    assert [*bad] == [7]
    with Oracle(
        breaking(fault), budget=12, workers=Workers(2, chunk_size=1), store=tmp_path / "a.sqlite"
    ) as oracle:
        scores = oracle(mu)
        assert {*oracle.invalid} == {*bad}
        assert toys.REASONS[fault] in next(iter(oracle.invalid.values()))
    healthy = breaking("none").evaluate(mu, seeds).score
    assert (np.delete(scores, [*bad]) == np.delete(healthy, [*bad])).all()
    # with one process it would die in this world; the store knows better
    with Oracle(breaking(fault), budget=12, store=tmp_path / "a.sqlite") as oracle:
        assert (oracle(mu) == scores).all()


@pytest.mark.long
def test_a_worker_that_dies_ends_a_run_that_must_not_break(tmp_path):
    application = breaking("os._exit", on_error="raise")
    with (
        Oracle(application, budget=12, workers=2) as oracle,
        pytest.raises(WorkerError, match=r"ended with exit code 7.*on_error='invalid'"),
    ):
        oracle(one_that_breaks())


@pytest.mark.long
def test_a_world_that_hangs_is_stopped():
    mu = one_that_breaks()
    bad = breaking("raises").evaluate(mu, evaluation_seeds(0, "train", 0, 12)).invalid
    with Oracle(breaking("hangs", timeout=1.0), budget=12, workers=2) as oracle:
        oracle(mu)
        assert {*oracle.invalid} == {*bad}
        assert {*oracle.invalid.values()} == {"it took longer than 1 s"}


def test_a_slow_world_is_stopped_between_its_steps_by_a_single_process():
    application = breaking("slow", timeout=0.2)
    mu = one_that_breaks()
    bad = breaking("raises").evaluate(mu, range(12)).invalid
    assert {*application.evaluate(mu, range(12)).invalid} == {*bad}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"on_error": "ignore"}, "on_error to be one of raise, invalid, fooled"),
        ({"valid": 3}, "valid to be a function"),
        ({"timeout": 0}, "timeout to be a number of seconds above 0"),
        ({"timeout": "1"}, "timeout to be a number of seconds above 0"),
    ],
)
def test_bad_arguments_get_a_sentence(change, message):
    with pytest.raises(UserError, match=message):
        breaking("none", **change)


def test_defaults_leave_the_key_of_stored_scores_as_it_was():
    assert {*breaking("none").settings}.isdisjoint({"on_error", "valid", "timeout", "feasible"})
    assert breaking("none", timeout=2).settings["timeout"] == 2.0


@pytest.mark.parametrize(
    ("verdict", "reason"), [(False, "judge says so"), ("too light", "too light")]
)
def test_a_function_judges_worlds_at_their_ends(verdict, reason):
    def judge(env):
        assert env.steps == 5
        return not toys.breaks(env.mass) or verdict

    application = breaking("none", valid=judge)
    mu = uniform(40)
    invalid = application.evaluate(mu, range(40)).invalid
    assert {*invalid.values()} == {reason}
    assert invalid.keys() == breaking("raises").evaluate(mu, range(40)).invalid.keys()


def test_a_judge_that_answers_nothing_gets_a_sentence():
    with pytest.raises(UserError, match=r"True, False or a text .* from <lambda>, got None"):
        breaking("none", valid=lambda env: None).evaluate(uniform(1), [0])


def test_a_mujoco_simulation_that_blows_up_is_invalid():
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco imageio")
    application = GymnasiumApplication(
        "Hopper-v5",
        agent=toys.still,
        agent_id="still",
        parameters={"speed": toys.SPEED, "mass": toys.TORSO},
        score=("length", 20),
        fooling_threshold=0.5,
        max_steps=20,
    )
    mu = np.array([[-1, 0], [1, 0], [-1, -1]], np.float32)
    invalid = application.evaluate(mu, [0, 1, 2]).invalid
    assert "MuJoCo warned of BAD" in invalid[1]
    assert invalid[2] == "its body_mass is negative or NaN"
    assert 0 not in invalid


def test_worlds_made_at_once_fit_a_bounded_memory(monkeypatch):
    monkeypatch.setattr(toys.Heaped, "alive", 0, raising=False)
    most = 0

    class Counted(toys.Heaped):
        def __init__(self, *args, **kwargs):
            nonlocal most
            super().__init__(*args, **kwargs)
            Counted.alive += 1
            most = max(most, Counted.alive)

        def close(self):
            Counted.alive -= 1

    # what the process itself takes hangs on the memory that earlier tests left free
    monkeypatch.setattr(
        "sada_gym.envs.wrapped.episodes.resident_bytes", lambda: Counted.alive * 2**24
    )
    mu = uniform(60)
    scores = breaking("none", environment=Counted, env_kwargs={}).evaluate(mu, range(60)).score
    assert 1 <= most <= MEMORY_BYTES // 2**24 + 4
    assert (scores == breaking("none").evaluate(mu, range(60)).score).all()


@pytest.mark.parametrize("count", [1, 2, 4])
def test_state_that_episodes_share_is_found_before_a_score_counts(count):
    application = breaking("none", environment=toys.Sharing, env_kwargs={})
    with pytest.raises(UserError, match=r"episodes of Sharing that share nothing.*in reset"):
        application.evaluate(uniform(count), range(count))


def test_randomness_is_traced_to_the_one_that_has_it():
    rng = np.random.default_rng()

    class Restless(toys.Breaking):
        def step(self, action):
            self.wind = rng.normal()
            return super().step(action)

    application = breaking("none", environment=Restless, env_kwargs={})
    with pytest.raises(UserError, match="The environment is random, and not the agent"):
        application.evaluate(uniform(3), range(3))
    application = breaking("none", agent=lambda seen: [rng.normal()])
    with pytest.raises(UserError, match="an agent that answers the same whenever it is asked"):
        application.evaluate(uniform(3), range(3))


def test_checks_that_find_the_same_say_it_once():
    rng = np.random.default_rng()
    report = check_application(breaking("none", agent=lambda seen: [rng.normal()]))
    failed = [check for check in report.checks if not check.passed]
    telling = [check.name for check in failed if "Expected an agent that" in check.sentence]
    assert telling == ["randomness"]
    assert len([check for check in failed if check.sentence.startswith("See randomness")]) >= 5


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (lambda seen: torch.ones(1, requires_grad=True), r"Return action\.detach\(\)"),
        (lambda seen: None, "an action from push, got None"),
    ],
)
def test_actions_that_are_none_get_a_sentence(agent, message):
    with pytest.raises(UserError, match=message):
        breaking("none", agent=agent).evaluate(uniform(1), [0])


def test_a_store_whose_invalid_worlds_are_damaged_is_refused(tmp_path):
    path = tmp_path / "run.sqlite"
    with Oracle(breaking("raises"), budget=40, store=path) as oracle:
        oracle(uniform(40))
        assert oracle.invalid
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript("DROP TABLE invalid; CREATE TABLE invalid (seed)")
    with pytest.raises(StoreError, match=r"it lacks invalid\.context"):
        Oracle(breaking("raises"), budget=40, store=path)
