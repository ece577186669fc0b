"""The quadrotor as an application: scores, what it tells, pictures, and agents of one's own."""

import re

import numpy as np
import pytest
from stable_baselines3 import PPO
from zoo import needs

import sada_gym
from sada_gym import agents
from sada_gym.envs.quadrotor.application import QuadrotorApplication
from sada_gym.envs.quadrotor.behaviour import behaviour
from sada_gym.envs.quadrotor.card import CARD
from sada_gym.envs.quadrotor.episodes import QuadrotorEpisodes
from sada_gym.envs.quadrotor.frame import CHART, HEIGHT, WIDTH
from sada_gym.envs.quadrotor.start import PARAMETERS, PLATFORMS, FlightEnd, QuadrotorStart
from sada_gym.envs.quadrotor.world.dynamics import BOUND_M, HEIGHT_M, SETTLED, STEPS
from sada_gym.errors import MissingPart
from sada_gym.testing.purity import assert_pure, compare_outcomes, draw_worlds
from sada_gym.testing.rules import check_live_parameters, check_outcomes

D = len(PARAMETERS)


GOLDEN = ["crashed", *["flown"] * 5], [0.0, 0.07625, 1.0, 1.0, 1.0, 0.1225]


class Autopilot:
    """A cascade of proportional controllers: wanted velocity, tilt, body rates, motors."""

    fingerprint = "autopilot"
    mixer = np.array([[-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])

    def start(self, count):
        pass

    def act(self, episodes, which):
        seen = episodes.observe(which)["state"].astype(np.float64)
        wanted = -3.0 * seen[:, :3] - 3.0 * seen[:, 12:15]
        lean = np.column_stack([-wanted[:, 1], wanted[:, 0]]) / 9.81 - np.column_stack(
            [seen[:, 10], -seen[:, 9]]
        )
        rates = np.column_stack([6.0 * lean.clip(-1, 1), 0 * lean[:, 0]]) - seen[:, 15:18]
        turn = 0.02 * rates
        hover = np.array([episodes.starts[i].hover for i in which])[:, None]
        throttle = hover * np.sqrt(np.clip(1 + wanted[:, 2:3] / 9.81, 0.2, 2)) + turn @ self.mixer.T
        return 2 * throttle - 1


class Falling(Autopilot):
    fingerprint = "falling"

    def act(self, episodes, which):
        return np.full((len(which), 4), -1.0)


def falling(**keywords):
    return QuadrotorApplication(agent=Falling(), **keywords)


def test_an_autopilot_of_ones_own_follows_in_mild_worlds_and_scores_are_pure():
    application = QuadrotorApplication(agent=Autopilot())
    mu, seeds = np.zeros((3, D)), [0, 1, 2]
    mu[:, [8, 9, 10, 12, 13]] = -1.0  # no weak motor, still air, no delay, nothing to follow
    outcomes = application.evaluate(mu, seeds)
    assert (outcomes.score > 0.9).all()
    assert {info["ending"] for info in outcomes.infos} == {"flown"}
    assert_pure(application, n=4, sizes=(3,), other_process=False)


def test_more_worlds_than_fly_at_a_time_are_the_same(monkeypatch):
    mu, seeds = draw_worlds(falling(), 3, 1)
    together = falling().evaluate(mu, seeds)
    monkeypatch.setattr(QuadrotorApplication, "worlds_at_once", 2)
    compare_outcomes(together, falling().evaluate(mu, seeds), "two at a time", [0, 1, 2])


def test_what_becomes_of_flights():
    flights = falling().episodes(np.zeros((3, D), np.float32), [0, 1, 2])
    flights.states[1, 9] = 200.0  # it shoots up
    flights.states[2, 3:7] = 0.0, 1.0, 0.0, 0.0  # upside down
    while len(which := flights.under_way()):
        flights.step(which, np.full((len(which), 4), -1.0))
    assert [info["ending"] for info in map(flights.info, range(3))] == [
        "crashed",
        "lost",
        "crashed",
    ]
    assert (flights.score == 0.0).all()
    assert flights.info(1)["flown_s"] < 0.05  # 3 m away, at once
    assert flights.info(0)["flown_s"] == pytest.approx(np.sqrt(2 * HEIGHT_M / 9.81), abs=0.2)
    assert [info["upset"] for info in map(flights.info, range(3))] == [False, False, True]
    found = behaviour(flights, [2])
    assert found.events == ("tumbled to the ground",)
    assert found.text.startswith("upside down after 0.0 s, hit the ground after 0.")
    (text,) = (found.text for found in falling().behaviours(np.zeros((1, D)), [0]))
    assert re.fullmatch(r"hit the ground after 0\.\d s", text)


def test_only_what_is_near_counts_and_only_after_two_seconds():
    flights = falling().episodes(np.zeros((1, D), np.float32), [0])
    still = np.array([0])
    at = {SETTLED - 1: 0.0, SETTLED + 1: BOUND_M - 0.01, SETTLED + 2: BOUND_M + 0.01}
    for step in range(STEPS):
        flights.states[0] = 0.0
        flights.states[0, :3] = flights.targets[0, 0], flights.targets[0, 1], HEIGHT_M
        flights.states[0, 3] = 1.0
        flights.states[0, 2] += at.get(step, 2.0)
        flights.step(still, np.full((1, 4), -1.0))
    assert flights.told[0, 5] == FlightEnd.FLOWN
    assert flights.score[0] == 1 / (STEPS - SETTLED)


def test_what_an_evaluation_tells():
    application = falling()
    check_outcomes(application)
    assert set(application.evaluate(np.zeros((1, D)), [3]).infos[0]) >= {
        *("ending", "flown_s", "upset", "far_m", "turning_rad_s"),
    }


@pytest.mark.parametrize("platform", PLATFORMS)
def test_every_parameter_changes_the_flight(platform):
    check_live_parameters(QuadrotorApplication(platform, agent=Autopilot()))


def test_pictures_show_the_flight_and_where_it_ended():
    application = falling()
    mu = np.zeros(D)
    picture = application.render(mu, 3)
    assert picture.shape[1] == WIDTH
    red = (np.abs(picture.astype(int) - (213, 94, 0)) < 12).all(axis=-1)
    assert red.any()
    assert application.observation(mu, 3).shape == (HEIGHT, WIDTH, 3)
    frames, score = application.replay(mu, 3)
    assert score == 0.0
    assert len({frame.shape for frame in frames}) == 1
    assert frames[0].shape[0] > HEIGHT + CHART
    flights = application.episodes(np.zeros((1, D), np.float32), [3])
    assert flights.render(np.array([0])).shape == (1, HEIGHT, WIDTH, 3)


def test_unknown_platforms_are_refused():
    with pytest.raises(ValueError, match=r"platform to be one of crazyflie, x500; got 'x5000'"):
        QuadrotorApplication("x5000", agent=Falling())


@pytest.mark.parametrize("actions", [np.zeros((1, 3)), np.full((1, 4), np.nan)])
def test_actions_of_another_shape_or_none_are_refused(actions):
    flights = QuadrotorEpisodes([QuadrotorStart("x500", PARAMETERS.describe(np.zeros(D)), 0)])
    with pytest.raises(ValueError, match=r"Expected (finite )?actions"):
        flights.step(np.array([0]), actions)


def test_the_package_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(
        "sada_gym.agents.packaged._version", lambda package: "1.0.1" if "-" in package else "3"
    )
    assert CARD.missing.startswith("Expected the package foundation-policy 1.0.2, got 1.0.1. ")
    with pytest.raises(MissingPart, match=r"got 1\.0\.1.*zoo"):
        agents.load("raptor", CARD.name)


@needs("foundation-policy", "h5py")
class TestRaptor:
    @pytest.mark.parametrize("platform", PLATFORMS)
    def test_it_follows_in_nominal_worlds(self, platform):
        application = sada_gym.make_application("SADA-Quadrotor-v0", platform=platform)
        outcomes = application.evaluate(np.zeros((20, D)), range(20))
        assert outcomes.fooled.mean() <= 0.05

    def test_golden_flights(self):
        mu = np.random.default_rng(0).uniform(-1, 1, (6, D)).round(1)
        outcomes = sada_gym.make_application("SADA-Quadrotor-v0").evaluate(mu, range(6))
        assert [info["ending"] for info in outcomes.infos] == GOLDEN[0]
        np.testing.assert_allclose(outcomes.score, GOLDEN[1], atol=0.005)

    def test_old_observations_make_an_agile_quadrotor_shake(self):
        application = sada_gym.make_application("SADA-Quadrotor-X500-v0")
        mu = np.zeros((2, D))
        mu[:, [3, 12]] = (0.8, -1.0), (0.8, 1.0)
        calm, shaking = application.behaviours(mu, [0, 0])
        assert not calm.events
        assert shaking.events
        assert shaking.data["turning_rad_s"] > 4 * calm.data["turning_rad_s"]


def test_a_model_of_ones_own_is_refused_where_its_spaces_are_others():
    model = PPO("MlpPolicy", "CartPole-v1", device="cpu")
    with pytest.raises(ValueError, match="Expected an agent with observations Dict"):
        QuadrotorApplication(agent=model)


@pytest.mark.long
@needs("foundation-policy", "h5py")
def test_two_workers_and_a_run_that_goes_on_give_the_same_bits(tmp_path):
    mu = np.random.default_rng(0).uniform(-1, 1, (8, D))
    track, store = "SADA-Quadrotor-X500-v0", tmp_path / "run.sqlite"
    with sada_gym.Oracle(track, budget=8, seed=0) as oracle:
        expected = oracle(mu)
    with sada_gym.Oracle(track, budget=8, seed=0, workers=2, store=store) as oracle:
        np.testing.assert_array_equal(oracle(mu[:5]), expected[:5])
    with sada_gym.Oracle(track, budget=8, seed=0, store=store) as oracle:
        np.testing.assert_array_equal(oracle(mu), expected)
