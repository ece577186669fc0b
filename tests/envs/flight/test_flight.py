"""The flight as an application: scores, what becomes of flights, pictures, agents of one's own."""

import re
import subprocess
import sys

import numpy as np
import pytest
from zoo import needs

import sada_gym
from sada_gym import agents
from sada_gym.envs.flight.application import FlightApplication
from sada_gym.envs.flight.card import CARD
from sada_gym.envs.flight.episodes import FlightEpisodes
from sada_gym.envs.flight.frame import CHART, UPPER, WIDTH
from sada_gym.envs.flight.start import (
    AIRCRAFT,
    COMMAND_S,
    FLIGHT_S,
    NOMINAL,
    PARAMETERS,
    POLICY_HZ,
    SETTLED_S,
    FlightEnd,
    FlightStart,
)
from sada_gym.envs.flight.world.engine import FIELDS, Flight
from sada_gym.errors import MissingPart
from sada_gym.testing.purity import assert_pure, compare_outcomes
from sada_gym.testing.rules import check_outcomes

D = len(PARAMETERS)
needs_jsbsim = needs("jsbsim")


def world(**changed):
    """The mu of the nominal world, but for some physical values."""
    values = {**PARAMETERS.describe(NOMINAL), **changed}
    return PARAMETERS.normalised([values[name] for name in PARAMETERS.names])


def start(aircraft="c172", seed=0, **changed):
    return FlightStart(aircraft, PARAMETERS.describe(world(**changed)), seed)


def flown(begun, steps, autopilot=True):
    flight = Flight(begun)
    if autopilot:
        flight.engage()
    for _ in range(steps):
        flight.fly([0.0, 0.0, 0.0, 0.0])
    return dict(zip(FIELDS, flight.state(), strict=True))


class Pushes:
    """Pushes the nose down, or does whatever else it is told to."""

    fingerprint = "pushes"

    def __init__(self, *action):
        self.action = action or (1.0, 0.0, 0.0, 0.0)

    def start(self, count):
        pass

    def act(self, episodes, which):
        return np.tile(self.action, (len(which), 1))


def test_the_package_is_named_where_it_is_missing_or_another(monkeypatch):
    monkeypatch.setattr("sada_gym.agents.packaged._version", lambda package: "1.2.0")
    assert CARD.missing.startswith("Expected the package jsbsim 1.3.3, got 1.2.0. ")
    for fly in (FlightApplication, lambda: FlightApplication(agent=Pushes())):
        with pytest.raises(MissingPart, match=r"got 1\.2\.0.*zoo"):
            fly()


@needs_jsbsim
def test_aircraft_files_that_are_missing_are_named(monkeypatch, tmp_path):
    class Installed:
        version = "1.3.3"

        @staticmethod
        def locate_file(member):
            return tmp_path / member

    monkeypatch.setattr("sada_gym.agents.packaged.distribution", lambda package: Installed)
    with pytest.raises(MissingPart, match=r"c172x\.xml of jsbsim 1\.3\.3 .*got no such fil"):
        FlightApplication(agent=Pushes())


@needs_jsbsim
class TestWorld:
    @pytest.mark.parametrize("aircraft", AIRCRAFT)
    @pytest.mark.parametrize(("payload", "balance"), [(0.0, 0.0), (1.0, 1.0)])
    def test_the_load_is_within_the_manual(self, aircraft, payload, balance):
        flight = Flight(start(aircraft, payload=payload, balance=balance))
        built, fdm = AIRCRAFT[aircraft], flight._fdm
        assert not flight.fault
        limit = np.interp(fdm["inertia/weight-lbs"], *zip(*built.forward_in, strict=True))
        assert fdm["inertia/cg-x-in"] == pytest.approx(built.aft_in if balance else limit, abs=0.02)
        assert fdm["inertia/cg-y-in"] == pytest.approx(0.0, abs=1e-6)
        if payload:
            assert fdm["inertia/weight-lbs"] == pytest.approx(built.most_lb, rel=1e-4)

    @pytest.mark.parametrize("aircraft", AIRCRAFT)
    def test_it_begins_in_level_flight(self, aircraft):
        now = flown(start(aircraft, turbulence=0.0), 2)
        assert now["altitude_ft"] == pytest.approx(5_000.0, abs=10.0)
        assert now["speed_kt"] == pytest.approx(start(aircraft).speed_kt, abs=3.0)

    @pytest.mark.parametrize("aircraft", AIRCRAFT)
    def test_the_autopilot_climbs_and_turns(self, aircraft):
        begun = start(aircraft, turbulence=0.0, climb_ft=200.0, turn_deg=-60.0)
        now = flown(begun, SETTLED_S * POLICY_HZ)
        assert now["altitude_ft"] == pytest.approx(5_200.0, abs=90.0)
        assert now["heading_deg"] == pytest.approx(30.0, abs=5.0)
        assert now["north_m"] > 500.0
        assert now["east_m"] > 500.0

    def test_ice_takes_lift_and_adds_drag(self):
        after = 31 * POLICY_HZ
        clean = flown(start("global5000", turbulence=0.0, turn_deg=0.0), after)
        dragged = flown(start("global5000", turbulence=0.0, turn_deg=0.0, added_drag=0.4), after)
        heavy = flown(start("global5000", turbulence=0.0, turn_deg=0.0, lost_lift=0.3), after)
        assert dragged["throttle"] > clean["throttle"] + 0.03
        assert heavy["alpha_rad"] > 1.2 * clean["alpha_rad"]

    def test_the_pitch_servo_sticks_and_the_air_sinks(self):
        after = (COMMAND_S + 4) * POLICY_HZ
        still = flown(start("c310", turbulence=0.0, climb_ft=300.0), after)
        stuck = flown(start("c310", turbulence=0.0, climb_ft=300.0, stuck_s=4.0), after)
        assert still["climb_fps"] > stuck["climb_fps"] + 3.0
        sinking = {"turbulence": 0.0, "downdraught_ft_min": 1_000.0}
        low = flown(start("c310", **sinking), 30 * POLICY_HZ, autopilot=False)
        assert low["altitude_ft"] < 4_950.0

    def test_flights_that_live_at_once_have_turbulence_of_their_own(self):
        begun = [start(seed=seed, turbulence=4.0) for seed in (0, 1)]
        alone = [flown(one, 40) for one in begun]
        assert alone[0] != alone[1]
        flights = [Flight(one) for one in begun]
        for flight in flights:
            flight.engage()
        for _ in range(40):
            for flight in flights:
                flight.fly([0.0, 0.0, 0.0, 0.0])
        assert [dict(zip(FIELDS, flight.state(), strict=True)) for flight in flights] == alone

    def test_it_prints_nothing(self):
        code = (
            "import numpy as np, sada_gym\n"
            "application = sada_gym.make_application('SADA-Flight-C310-v0')\n"
            "with __import__('contextlib').closing(application.episodes("
            "np.zeros((1, 13), np.float32), [0])) as flights:\n"
            "    flights.step(np.array([0]), np.zeros((1, 4)))\n"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        assert (done.stdout, done.stderr) == (b"", b"")


@needs_jsbsim
class TestApplication:
    def test_scores_are_pure(self):
        application = FlightApplication("c310", agent=Pushes(0.02, 0.0, 0.0, 0.0))
        assert_pure(application, n=3, sizes=(2,), other_process=False)

    @pytest.mark.long
    @pytest.mark.parametrize("track", CARD.track_ids)
    def test_the_autopilot_holds_in_nominal_worlds_and_is_pure(self, track):
        application = sada_gym.make_application(track)
        mu = np.stack([NOMINAL, world(turbulence=4.0, servo_s=3.0), NOMINAL])
        outcomes = application.evaluate(mu, [1, 2, 3])
        assert outcomes.score[[0, 2]].min() > 0.95
        again = application.evaluate(mu[[1, 0]], [2, 1])
        compare_outcomes(
            type(outcomes)(
                outcomes.score[[1, 0]],
                outcomes.fooled[[1, 0]],
                (outcomes.infos[1], outcomes.infos[0]),
            ),
            again,
            "in another order",
            [0, 1],
        )

    def test_what_an_evaluation_tells(self):
        application = FlightApplication("global5000", agent=Pushes())
        check_outcomes(application)
        (info,) = application.evaluate(NOMINAL[None], [3]).infos
        assert (info["ending"], info["score"], info["invalid"]) == ("upset", 0.0, "")
        assert info["flown_s"] < 30.0
        (told,) = application.behaviours(NOMINAL[None], [3])
        assert re.fullmatch(r"upset after \d+ s: banked \d+°, nose 1\d° down, \d+ kt", told.text)
        assert told.events == ("upset",)

    def test_a_pulled_nose_stalls(self):
        application = FlightApplication("c310", agent=Pushes(-1.0, 0.0, 0.0, -1.0))
        (told,) = application.behaviours(world(turbulence=0.0)[None], [0])
        assert told.text.startswith(("stalled after", "upset after"))

    def test_a_trim_that_fails_is_an_invalid_world_and_no_failure(self, monkeypatch):
        monkeypatch.setitem(AIRCRAFT, "c310", AIRCRAFT["c310"]._replace(trims=True, advance=1.0))
        outcomes = FlightApplication("c310", agent=Pushes()).evaluate(NOMINAL[None], [0])
        assert outcomes.invalid == {0: "JSBSim finds no trim for level flight"}
        assert not outcomes.fooled[0]
        assert outcomes.infos[0]["ending"] == "invalid"

    def test_a_state_that_is_no_number_is_an_invalid_world(self, monkeypatch):
        flights = FlightEpisodes([start("c310")])
        monkeypatch.setattr(flights.flights[0], "state", lambda: [np.nan] * len(FIELDS))
        flights.step(np.array([0]), np.zeros((1, 4)))
        assert not len(flights.under_way())
        assert flights.info(0)["invalid"] == "JSBSim could not compute the flight"
        assert np.isfinite(flights.states).all()

    def test_only_what_is_held_after_the_manoeuvre_counts(self, monkeypatch):
        flights = FlightEpisodes([start("c310", climb_ft=100.0, turn_deg=20.0)])
        flight, wanted = flights.flights[0], np.array(flights.states[0])
        monkeypatch.setattr(flight, "fly", lambda controls: None)
        monkeypatch.setattr(flight, "state", lambda: wanted.tolist())
        at = {SETTLED_S * POLICY_HZ: (0, 0), SETTLED_S * POLICY_HZ + 1: (99, 9)}
        at |= {SETTLED_S * POLICY_HZ + 2: (-99, -9), SETTLED_S * POLICY_HZ + 3: (0, 11)}
        for step in range(1, FLIGHT_S * POLICY_HZ + 1):
            off_ft, off_deg = at.get(step, (101, 0))
            wanted[:2] = 5_100.0 + off_ft, 110.0 + off_deg
            flights.step(np.array([0]), np.zeros((1, 4)))
        assert flights.told[0, 3] == FlightEnd.FLOWN
        assert flights.score[0] == 2 / (POLICY_HZ * (FLIGHT_S - SETTLED_S))
        assert flights.info(0)["altitude_error_ft"] == pytest.approx(101.0)

    def test_what_agents_observe(self):
        flights = FlightEpisodes([start("c172", turbulence=0.0)])
        flights.states[0, :2] = 4_950.0, 355.0
        (state,) = flights.observe(np.array([0]))["state"]
        assert flights.observation_space["state"].contains(state)
        np.testing.assert_allclose(state[:3], [0.5, 9.5, 0.91], atol=0.01)

    def test_pictures_show_the_flight_and_where_it_ended(self):
        application = FlightApplication("c310", agent=Pushes())
        picture = application.render(NOMINAL, 3)
        assert picture.shape[1] == WIDTH
        red = (np.abs(picture.astype(int) - (213, 94, 0)) < 12).all(axis=-1)
        assert red.any()
        assert application.observation(NOMINAL, 3).shape == (UPPER, WIDTH, 3)
        frames, score = application.replay(NOMINAL, 3)
        assert score == 0.0
        assert len({frame.shape for frame in frames}) == 1
        assert frames[0].shape[0] > UPPER + 2 * CHART
        flights = application.episodes(NOMINAL[None], [3])
        assert flights.render(np.array([0])).shape == (1, UPPER, WIDTH, 3)
        flights.close()

    @pytest.mark.parametrize("actions", [np.zeros((1, 3)), np.full((1, 4), np.nan)])
    def test_actions_of_another_shape_or_none_are_refused(self, actions):
        with pytest.raises(ValueError, match=r"Expected (finite )?actions"):
            FlightEpisodes([start()]).step(np.array([0]), actions)

    def test_the_autopilot_may_stay_on_under_an_agent_of_ones_own(self):
        flights = FlightEpisodes([start("c310", turbulence=0.0) for _ in range(2)])
        flights.engage(np.array([1]))
        for _ in range(30 * POLICY_HZ):
            flights.step(np.arange(2), np.tile([0.05, 0.0, 0.0, 0.0], (2, 1)))
        alone, helped = flights.states[:, 0]
        assert helped > alone + 50.0

    def test_unknown_aircraft_are_refused(self):
        with pytest.raises(ValueError, match=r"aircraft to be one of c172, c310, global5000"):
            FlightApplication("b747")

    def test_the_autopilots_fingerprint_is_that_of_the_files(self):
        built_in = agents.load("built-in", CARD.name)
        assert re.fullmatch(r"[0-9a-f]{64}", built_in.fingerprint)
        assert FlightApplication().fingerprint != FlightApplication(agent=Pushes()).fingerprint
