"""The Go2's walking policy: the rule that ranges have to pass, and what each parameter does.

    python -m studies.go2 rates
    python -m studies.go2 alone

`rates` says how often ordinary worlds (the nominal one, on many seeds), worlds in the middle of all
ranges (mu = 0) and uniform worlds fool the policy, and how the walks of the uniform ones end; 6
minutes on one core. `alone` walks ordinary worlds in which a single thing has changed; 2 minutes.
In brackets: 95 % intervals.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from studies.shares import share

ORDINARY, MIDDLE, UNIFORM, EACH = 200, 100, 400, 10
_LOADED = {"payload_kg": 8.0}
ALONE: tuple[dict[str, float], ...] = (
    *({"friction": 0.3}, {"friction": 1.0}, {"slope_deg": -20.0}, {"slope_deg": 20.0}),
    *({"step_height_m": 0.1}, _LOADED, {**_LOADED, "payload_ahead_m": -0.19}),
    *({**_LOADED, "payload_ahead_m": 0.19}, {**_LOADED, "payload_left_m": 0.05}),
    *({"push_m_s": 2.0, "push_direction_deg": degrees} for degrees in (0.0, 90.0, 180.0, -90.0)),
    *({"motor_lag_s": 0.01}, {"motor_lag_s": 0.02}, {"motor_strength": 0.7}),
    *({"motor_strength": 1.3}, {"speed_m_s": 0.3}, {"speed_m_s": 1.0}),
    *({"turn_rad_s": -1.0}, {"turn_rad_s": 1.0}, {"delay_s": 0.005}, {"delay_s": 0.01}),
)


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


def alone(application: Application) -> None:
    """Print how ordinary worlds end in which one thing is as far off as it can be."""
    names, usual = (
        application.parameters.names,
        application.parameters.physical(application.nominal),
    )
    for changed in ALONE:
        values = usual.copy()
        for name, value in changed.items():
            values[names.index(name)] = value
        mu = np.tile(application.parameters.normalised(values), (EACH, 1))
        score = application.evaluate(mu, range(EACH)).score
        fooled = int((score <= application.fooling_threshold).sum())
        what = ", ".join(f"{name} {value:g}" for name, value in changed.items())
        print(f"| {what} | {fooled} of {EACH} | {score.mean():.2f} |", flush=True)


def main() -> None:
    """Run what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["rates", "alone"])
    named = {"rates": rates, "alone": alone}[parser.parse_args().what]
    named(make_application("SADA-Go2-v0"))


if __name__ == "__main__":
    main()
