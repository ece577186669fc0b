"""RAPTOR on both platforms: the rule that ranges have to pass, and what old observations do.

    python -m studies.quadrotor rates
    python -m studies.quadrotor delays

`rates` says how often nominal (mu = 0) and uniform worlds fool the pilot, and how those flights
end. `delays` flies worlds that are nominal but for two parameters, the age of what is observed and
what the motors can do against inertia. In brackets: 95 % intervals. Each takes a few seconds.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from sada_gym.foundations.cards import find_card
from sada_gym.measures.rates import wilson_interval

CARD = find_card("SADA-Quadrotor")
NOMINAL, UNIFORM, EACH = 200, 2_000, 50
DELAYS_S = (0.0, 0.002, 0.004, 0.006, 0.008, 0.01)
TORQUES_TO_INERTIA = (100.0, 200.0, 400.0, 600.0, 900.0, 1200.0)


def share(fooled: np.ndarray) -> str:
    """Write a share with its interval."""
    low, high = wilson_interval(int(fooled.sum()), len(fooled))
    return f"{100 * fooled.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"


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
    parser.add_argument("what", choices=["rates", "delays"])
    what = parser.parse_args().what
    assert CARD is not None
    for track in CARD.track_ids:
        application = make_application(track)
        if what == "rates":
            print("|", " | ".join([track, *rates(application)]), "|")
            continue
        print(f"\n{track}\n| delay |", " | ".join(f"{x:.0f} 1/s²" for x in TORQUES_TO_INERTIA), "|")
        for row in delays(application):
            print("|", row, "|")


if __name__ == "__main__":
    main()
