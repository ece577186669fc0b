"""The flight's speed: `make bench`. No test fails on a time.

The yardstick is JSBSim alone, on the same aircraft for as many steps. The target is 1.2 times that.
"""

import statistics
import time

import numpy as np
import pytest
from zoo import needs

from sada_gym.envs.flight.application import FlightApplication
from sada_gym.envs.flight.start import (
    AIRCRAFT,
    FLIGHT_S,
    NOMINAL,
    PARAMETERS,
    POLICY_HZ,
    FlightStart,
)
from sada_gym.envs.flight.world.engine import RATE_HZ, Flight
from sada_gym.foundations.determinism import one_thread

pytestmark = needs("jsbsim")

FOUND: dict[str, float] = {}


@pytest.mark.parametrize("aircraft", AIRCRAFT)
def test_flights(benchmark, aircraft):
    application, mu = FlightApplication(aircraft), np.tile(NOMINAL, (4, 1))
    with one_thread():
        benchmark.pedantic(application.evaluate, args=(mu, range(4)), rounds=5, warmup_rounds=1)
    FOUND[f"s a world, {aircraft}"] = statistics.median(benchmark.stats.stats.data) / 4


@pytest.mark.parametrize("aircraft", AIRCRAFT)
def test_jsbsim_alone(benchmark, aircraft):
    def fly():
        for seed in range(4):
            flight = Flight(FlightStart(aircraft, PARAMETERS.describe(NOMINAL), seed))
            flight.engage()
            flight.fly([0.0] * 4)
            run = flight._fdm.run
            for _ in range(RATE_HZ // POLICY_HZ, FLIGHT_S * RATE_HZ):
                run()

    with one_thread():
        benchmark.pedantic(fly, rounds=5, warmup_rounds=1)
    bare_s = statistics.median(benchmark.stats.stats.data) / 4
    FOUND[f"times JSBSim alone, {aircraft}"] = FOUND[f"s a world, {aircraft}"] / bare_s


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: the flight")
        for name, figure in FOUND.items():
            print(f"{name:>35}: {figure:.2f}")
