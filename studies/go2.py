"""The Go2's walking policy: the rule that ranges have to pass, and what each parameter does.

    python -m studies.go2 rates
    python -m studies.go2 lag

`rates` says how often ordinary worlds (the nominal one, on many seeds), worlds in the middle of all
ranges (mu = 0) and uniform worlds fool the policy, and how the walks of the uniform ones end; 6
minutes on one core. `lag` walks ordinary worlds with slower motors and older observations; 5
minutes. In brackets: 95 % intervals.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from sada_gym.measures.rates import wilson_interval

ORDINARY, MIDDLE, UNIFORM, EACH = 200, 100, 400, 20
LAGS_S, DELAYS_S = (0.01, 0.0125, 0.015, 0.0175, 0.02), (0.0, 0.005, 0.01)


def share(fooled: np.ndarray) -> str:
    """Write a share with its interval."""
    low, high = wilson_interval(int(fooled.sum()), len(fooled))
    return f"{100 * fooled.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def rates(application: Application) -> None:
    """Print the rates, and how the uniform walks that fool end."""
    d = len(application.parameters)
    for name, mu, count in (
        ("ordinary", application.nominal, ORDINARY),
        ("middle", np.zeros(d), MIDDLE),
    ):
        fooled = application.evaluate(np.tile(mu, (count, 1)), range(count)).fooled
        print(f"{name}: {share(fooled)}", flush=True)
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (UNIFORM, d)).astype(np.float32)
    outcomes = application.evaluate(mu, range(UNIFORM))
    print(f"uniform: {share(outcomes.fooled)}, invalid: {len(outcomes.invalid)}", flush=True)
    for name, column in zip(application.parameters.names, mu.T, strict=True):
        third = np.digitize(column, (-1 / 3, 1 / 3))
        thirds = [f"{outcomes.fooled[third == k].mean():.0%}" for k in range(3)]
        print(f"  {name}: fooled in its lowest, middle and highest third: {', '.join(thirds)}")
    fooled = np.flatnonzero(outcomes.fooled)
    told = application.behaviours(mu[fooled], fooled.tolist())
    events = Counter(event for one in told for event in one.events)
    print(", ".join(f"{event} {n / len(told):.0%}" for event, n in events.most_common()))


def lag(application: Application) -> None:
    """Print the share of ordinary walks that fool for slower motors and older observations."""
    names, usual = (
        application.parameters.names,
        application.parameters.physical(application.nominal),
    )
    for delay_s in DELAYS_S:
        values = np.tile(usual, (len(LAGS_S), 1))
        values[:, names.index("delay_s")] = delay_s
        values[:, names.index("motor_lag_s")] = LAGS_S
        mu = np.repeat(application.parameters.normalised(values), EACH, axis=0)
        fooled = application.evaluate(mu, [*range(EACH)] * len(values)).fooled
        shares = fooled.reshape(len(values), EACH).mean(axis=1)
        print(
            f"{1000 * delay_s:.0f} ms | " + " | ".join(f"{one:.0%}" for one in shares), flush=True
        )


def main() -> None:
    """Run what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["rates", "lag"])
    named = {"rates": rates, "lag": lag}[parser.parse_args().what]
    named(make_application("SADA-Go2-v0"))


if __name__ == "__main__":
    main()
