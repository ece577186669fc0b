"""RAPTOR on both platforms: the rule that ranges have to pass, and what old observations do.

    python -m studies.quadrotor rates
    python -m studies.quadrotor built
    python -m studies.quadrotor delays

`rates` says how often nominal (mu = 0) and uniform worlds fool the pilot, and how those flights
end. `built` flies the platforms as they are built, in uniform conditions otherwise. `delays` flies
worlds that are nominal but for two parameters, the age of what is observed and what the motors can
do against inertia. In brackets: 95 % intervals. Each takes some seconds.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from sada_gym.envs.quadrotor.application import QuadrotorApplication
from sada_gym.envs.quadrotor.behaviour import behaviour
from sada_gym.envs.quadrotor.episodes import QuadrotorEpisodes
from sada_gym.envs.quadrotor.start import QuadrotorStart
from sada_gym.foundations.cards import find_card
from studies.shares import share

CARD = find_card("SADA-Quadrotor")
NOMINAL, UNIFORM, EACH = 200, 2_000, 50
OLD_S = 0.008
DELAYS_S = (0.0, 0.002, 0.004, 0.006, 0.008, 0.01)
BUILT = {
    "crazyflie": {"thrust_to_weight": 1.467, "torque_to_inertia": 463.0}
    | {"spin_up_s": 0.0555, "spin_down_s": 0.2494, "mass_ratio": 1.0, "arm_ratio": 1.0},
    "x500": {"thrust_to_weight": 3.247, "torque_to_inertia": 183.5}
    | {"spin_up_s": 0.054, "spin_down_s": 0.054, "mass_ratio": 1.0, "arm_ratio": 1.0},
}
"""The platforms' own figures, from l2f's files; mass and arms are as built, too."""
TORQUES_TO_INERTIA = (100.0, 200.0, 400.0, 600.0, 900.0, 1200.0)


def rates(application: Application) -> list[str]:
    """Return nominal and uniform rates, and how the uniform flights that fool end."""
    d = len(application.parameters)
    nominal = application.evaluate(np.zeros((NOMINAL, d)), range(NOMINAL)).fooled
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (UNIFORM, d)).astype(np.float32)
    seeds = list(range(UNIFORM))
    fooled = np.flatnonzero(application.evaluate(mu, seeds).fooled)
    told = application.behaviours(mu[fooled], [seeds[i] for i in fooled])
    events = Counter(event for one in told for event in one.events)
    ends = ", ".join(f"{event} {n / len(told):.0%}" for event, n in events.most_common())
    uniform = np.isin(np.arange(UNIFORM), fooled)
    return [share(nominal), share(uniform), ends]


def built(application: QuadrotorApplication) -> list[str]:
    """Return how often the platform as it is built is fooled, and how those flights end.

    The rate is that of all worlds, of those with old observations, and of the others.
    """
    rng = np.random.default_rng(1)
    mu = rng.uniform(-1.0, 1.0, (UNIFORM, len(application.parameters)))
    frame = BUILT[application.platform]
    starts = [
        QuadrotorStart(application.platform, application.parameters.describe(row) | frame, seed)
        for seed, row in enumerate(mu)
    ]
    fooled, events = [], Counter[str]()
    for first in range(0, UNIFORM, application.worlds_at_once):
        flights = QuadrotorEpisodes(starts[first : first + application.worlds_at_once])
        application.play(flights)
        fooled += (flights.score <= application.fooling_threshold).tolist()
        for i in np.flatnonzero(flights.score <= application.fooling_threshold).tolist():
            events.update(behaviour(flights, [i]).events)
    ends = ", ".join(f"{event} {n / sum(fooled):.0%}" for event, n in events.most_common())
    is_old = np.array([start.conditions["delay_s"] > OLD_S for start in starts])
    rates = [share(np.array(fooled)[part]) for part in (slice(None), is_old, ~is_old)]
    return [*rates, ends]


def delays(application: Application) -> list[str]:
    """Return a row a delay: the mean Q for each torque to inertia."""
    names, rows = application.parameters.names, []
    middle = application.parameters.physical(np.zeros(len(names)))
    for delay_s in DELAYS_S:
        values = np.tile(middle, (len(TORQUES_TO_INERTIA), 1))
        values[:, names.index("delay_s")] = delay_s
        values[:, names.index("torque_to_inertia")] = TORQUES_TO_INERTIA
        mu = np.repeat(application.parameters.normalised(values), EACH, axis=0)
        score = application.evaluate(mu, [*range(EACH)] * len(values)).score
        means = score.reshape(len(values), EACH).mean(axis=1)
        rows.append(f"{1000 * delay_s:.0f} ms | " + " | ".join(f"{mean:.2f}" for mean in means))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["rates", "built", "delays"])
    what = parser.parse_args().what
    assert CARD is not None
    for track in CARD.track_ids:
        application = make_application(track)
        assert isinstance(application, QuadrotorApplication)
        if what != "delays":
            cells = (rates if what == "rates" else built)(application)
            print("|", " | ".join([track, *cells]), "|")
            continue
        print(f"\n{track}\n| delay |", " | ".join(f"{x:.0f} 1/s²" for x in TORQUES_TO_INERTIA), "|")
        for row in delays(application):
            print("|", row, "|")


if __name__ == "__main__":
    main()
