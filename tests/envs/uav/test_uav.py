import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from registry_cases import NaNPilot
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from sada_gym.application import feasible_worlds
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.episodes import ACTION_SPACE, OBSERVATION_SPACE
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import GATES, Tracks
from sada_gym.testing.purity import assert_pure, compare_outcomes, draw_worlds
from sada_gym.testing.rules import check_outcomes


def application(anchors=3, speed_m_s=9.5):
    return UAVApplication(anchors, agent=PrivilegedPilot(speed_m_s))


def test_scores_are_pure():
    # at that speed it hits frames; test_racing_episodes.py flies more at a time
    assert_pure(application(4, 13.0), n=4, sizes=(3,), other_process=False)


def test_more_races_than_fly_at_a_time_are_the_same(monkeypatch):
    monkeypatch.setattr(UAVApplication, "worlds_at_once", 4)
    hasty = application(5, 12.0)
    mu, seeds = draw_worlds(hasty, 6, 3)
    together = hasty.evaluate(mu, seeds)
    compare_outcomes(
        together, hasty.evaluate(mu[3:], seeds[3:]), "without the first three", [3, 4, 5]
    )


@pytest.mark.parametrize("anchors", [3, 4, 5])
def test_the_environments_keep_gymnasiums_and_sb3s_rules(anchors):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(
            AdversaryEnv(UAVApplication, anchors=anchors, agent=PrivilegedPilot()),
            skip_render_check=True,
        )
        check_env_sb3(AdversaryEnv(UAVApplication, anchors=anchors, agent=PrivilegedPilot()))


def test_the_batch_equals_the_scalar_environments():
    batch = AdversaryVectorEnv(UAVApplication, anchors=4, agent=PrivilegedPilot(13.0), num_envs=3)
    batch.reset(seed=5)
    mu = draw_worlds(batch.application, 3, 0)[0]
    _, rewards, *_ = batch.step(mu)
    for i in range(3):
        env = AdversaryEnv(UAVApplication, anchors=4, agent=PrivilegedPilot(13.0))
        env.reset(seed=5 + i)
        assert env.step(mu[i])[1] == rewards[i]


def test_what_an_evaluation_tells():
    flown = application(4)
    check_outcomes(flown)
    (info,) = flown.evaluate(np.zeros((1, 8)), [0]).infos
    assert info["score"] == 1.0
    assert info["gates_passed"] == GATES
    assert info["endings"] == ["passed"] * GATES
    assert 8 < info["time_s"] < 11
    assert info["length_m"] == pytest.approx(80, abs=0.5)
    assert 45 < info["sharpest_turn_deg"] < 60
    assert 6 < info["closest_m"] < 9
    assert info["kept"] == 1.0


def test_a_sharp_crowded_track_says_so():
    mu = np.array([[1, 1, -1, 1, 0, -1.0]])
    info = application(3).evaluate(mu, [0]).infos[0]
    plain = application(3).evaluate(0 * mu, [0]).infos[0]
    assert info["sharpest_turn_deg"] > plain["sharpest_turn_deg"] + 10
    assert info["closest_m"] < plain["closest_m"] - 3
    assert info["length_m"] < plain["length_m"] - 40


GOLDEN = {
    3: [(8, 11.8667, 106.273), (8, 11.4375, 78.486), (8, 9.7875, 100.441)],
    4: [(8, 8.875, 85.336), (8, 8.6542, 78.039), (8, 8.6708, 138.314)],
    5: [(8, 9.125, 165.173), (8, 10.3167, 127.071), (8, 12.325, 99.263)],
}
"""Of the reference, which touches nothing there: gates passed, time in s, sharpest turn in deg."""


@pytest.mark.parametrize("anchors", GOLDEN)
def test_golden_races(anchors):
    mu = np.random.default_rng(anchors).uniform(-1, 1, (8, 2 * anchors)).round(1)[:3]
    figures = [
        (info["gates_passed"], info["time_s"], info["sharpest_turn_deg"])
        for info in application(anchors).evaluate(mu, [0, 1, 2]).infos
    ]
    np.testing.assert_allclose(figures, GOLDEN[anchors], atol=1e-3)


def test_the_reference_says_which_tracks_can_be_flown():
    slow = UAVApplication(3, agent=PrivilegedPilot(2.0))
    mu = draw_worlds(slow, 4, 0)[0]
    assert (slow.privileged_score(mu) > slow.fooling_threshold).all()
    np.testing.assert_array_equal(
        slow.privileged_score(mu, [5, 6, 7, 8]),
        UAVApplication(3, agent=PrivilegedPilot()).evaluate(mu, [5, 6, 7, 8]).score,
    )


class Diverging:
    """A pilot whose network is broken after a while."""

    fingerprint = "broken"

    def start(self, count):
        self.steps = 0

    def act(self, races, which):
        self.steps += 1
        actions = PrivilegedPilot().act(races, which)
        return actions * np.nan if self.steps > 60 else actions


def test_a_pilot_that_diverges_misses_what_is_left():
    outcomes = UAVApplication(5, agent=Diverging()).evaluate(np.zeros((2, 10)), [0, 1])
    for info in outcomes.infos:
        assert 0 < info["gates_passed"] < 6
        assert info["endings"][info["gates_passed"] :] == ["lost"] * (GATES - info["gates_passed"])
    assert outcomes.fooled.all()


def test_on_step_is_called_before_every_decision():
    flown = application(3)
    races = flown.episodes(np.zeros((2, 6), np.float32), [0, 1])
    seen = []
    flown.play(races, lambda races: seen.append(races.states.copy()))
    assert len(seen) == races.steps.max()
    assert (races.endings == GateOutcome.PASSED).all()
    races.close()


def test_an_application_can_be_sent_to_another_process():
    again = pickle.loads(pickle.dumps(application(4)))
    mu, seeds = draw_worlds(again, 2, 0)
    np.testing.assert_array_equal(
        again.evaluate(mu, seeds).score, application(4).evaluate(mu, seeds).score
    )


def test_settings_and_fingerprint_name_what_a_score_belongs_to():
    assert application(5).settings == {"anchors": 5}
    named = [
        UAVApplication(3, agent=PrivilegedPilot(speed), agent_id=name).fingerprint
        for speed, name in [(9.0, "mine"), (9.0, "mine"), (10.0, "mine"), (9.0, "other")]
    ]
    assert named[0] == named[1]
    assert len(set(named)) == 3
    assert UAVApplication(3, agent=PrivilegedPilot(), agent_id="mine").agent_name == "mine"
    assert PrivilegedPilot(9.0).fingerprint != PrivilegedPilot(10.0).fingerprint


@pytest.mark.parametrize("anchors", [2, 6, "3", 3.0, [3], True])
def test_other_numbers_of_anchors_are_refused(anchors):
    with pytest.raises(ValueError, match="Expected anchors among 3, 4, 5, got"):
        UAVApplication(anchors, agent=PrivilegedPilot())


class Stranger:
    """A model of another task."""

    def __init__(self, sees, acts):
        self.observation_space, self.action_space = sees, acts

    def predict(self, observation, *, deterministic):
        raise AssertionError


@pytest.mark.parametrize(
    ("sees", "acts"),
    [
        (spaces.Box(0, 1, (7,), np.float32), ACTION_SPACE),
        (OBSERVATION_SPACE, spaces.Discrete(3)),
        (OBSERVATION_SPACE, spaces.Box(-1, 1, (2,), np.float32)),
    ],
)
def test_a_model_of_another_task_is_named_with_both_spaces(sees, acts):
    message = r"Expected an agent with observations Dict\(.*, got observations .*SADA-RacingTask-v0"
    with pytest.raises(ValueError, match=message):
        UAVApplication(3, agent=Stranger(sees, acts))


def test_an_unknown_pilot_is_refused():
    with pytest.raises(ValueError, match=r"Expected .*'no-such-pilot'"):
        UAVApplication(3, agent="no-such-pilot")


def test_the_docstring_gives_ranges_and_endings_as_they_are():
    from sada_gym.envs.uav.world.track import LEAST_SPACING_M, TEMPLATES

    for anchors, chosen in TEMPLATES.items():
        row = f"| {anchors} | {2 * anchors} | {chosen.range_m:g} |"
        assert row in UAVApplication.__doc__
    assert f"at least {LEAST_SPACING_M} m apart" in UAVApplication.__doc__


def test_the_inner_task_is_no_adversary_environment():
    assert gym.spec("SADA-RacingTask-v0").kwargs == {}


@pytest.mark.slow
@pytest.mark.parametrize("anchors", [3, 4, 5])
def test_the_privileged_pilot_masters_nearly_every_track(anchors):
    rng = np.random.default_rng(7)
    mu = rng.uniform(-1, 1, (1000, 2 * anchors))
    score = UAVApplication(anchors).privileged_score(mu, rng.integers(2**31, size=1000).tolist())
    assert (score > UAVApplication.fooling_threshold).mean() >= 0.99
    assert score.mean() > 0.97


@pytest.mark.parametrize("seeds", [[1], [1, 2, 3], [-1, 2], [1.5, 2], ["a", 2]])
def test_bad_seeds_of_the_privileged_pilot_are_refused(seeds):
    with pytest.raises(ValueError, match=r"Expected (2 seeds|seeds to be ints)"):
        application().privileged_score(np.zeros((2, 6)), seeds)


def test_a_track_is_feasible_where_the_privileged_pilot_is_not_fooled(monkeypatch):
    ours = application()
    assert feasible_worlds(ours, np.zeros((2, 6)), [0, 1]).tolist() == [True, True]
    monkeypatch.setattr(UAVApplication, "fooling_threshold", 1.0)
    assert feasible_worlds(ours, np.zeros((1, 6)), [0]).tolist() == [False]


@pytest.mark.parametrize("name", ["waypoint-pid", "ppo"])
def test_the_shipped_pilots_fly_the_undisturbed_tracks(name):
    for anchors in (3, 4, 5):
        flown = UAVApplication(anchors, agent=name)
        outcomes = flown.evaluate(np.zeros((4, 2 * anchors)), range(4))
        assert outcomes.score.mean() > 0.95
        assert flown.agent_name == name


def test_tracks_are_built_once_a_batch(monkeypatch):
    built = []

    class Counted(Tracks):
        def __init__(self, anchors):
            built.append(len(anchors))
            super().__init__(anchors)

    monkeypatch.setattr("sada_gym.envs.uav.world.track.Tracks", Counted)
    application = UAVApplication(3, agent=NaNPilot())
    application.evaluate(np.zeros((5, 6)), range(5))  # the first time an agent is asked twice
    built.clear()
    application.evaluate(np.zeros((5, 6)), range(5))
    assert built == [5]
