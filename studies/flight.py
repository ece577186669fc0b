"""The autopilots of JSBSim: the rule that ranges have to pass, and what fools one and the others.

    python -m studies.flight rates [--track SADA-Flight-C310-v0]
    python -m studies.flight apart [--track SADA-Flight-C310-v0]

`rates` says how often nominal and uniform worlds fool the autopilot, how those flights end, how
often uniform worlds fool with turbulence as frequent as MIL-F-8785C says, and how many are invalid.
`apart` flies nominal worlds but for one parameter at either end of its range. In brackets: 95 %
intervals. A flight takes a fifth of a second.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from sada_gym import make_application
from sada_gym.application import Application
from sada_gym.foundations.cards import find_card
from studies.shares import share

CARD = find_card("SADA-Flight")
NOMINAL, UNIFORM, EACH = 200, 400, 10
OFTEN = (0.8, 0.1, 0.09, 0.009, 0.001)
"""How often the turbulence of each index is the strongest that is exceeded, by MIL-F-8785C."""


def rates(application: Application) -> list[str]:
    """Return nominal and uniform rates, and how the uniform flights that fool end."""
    nominal = application.evaluate(np.tile(application.nominal, (NOMINAL, 1)), range(NOMINAL))
    d = len(application.parameters)
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (UNIFORM, d)).astype(np.float32)
    uniform = application.evaluate(mu, range(UNIFORM))
    ends = Counter(
        "not held" if info["ending"] == "flown" else info["ending"]
        for info in uniform.infos
        if info["fooled"]
    )
    told = ", ".join(f"{end} {n / ends.total():.0%}" for end, n in ends.most_common())
    index = [min(int(info["parameters"]["turbulence"] + 0.5), 4) for info in uniform.infos]
    each = [uniform.fooled[np.array(index) == k].mean() for k in range(5)]
    usual = f"{100 * np.dot(OFTEN, each):.0f} %"
    return [share(nominal.fooled), share(uniform.fooled), told, usual, f"{len(uniform.invalid)}"]


def apart(application: Application) -> list[str]:
    """Return a row a parameter: how often either end of its range fools in nominal worlds."""
    rows = []
    for k, parameter in enumerate(application.parameters.parameters):
        mu = np.tile(application.nominal, (2 * EACH, 1))
        mu[:EACH, k], mu[EACH:, k] = -1.0, 1.0
        fooled = application.evaluate(mu, [*range(EACH)] * 2).fooled
        rows.append(f"{parameter.label} | {fooled[:EACH].sum()} | {fooled[EACH:].sum()}")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["rates", "apart"])
    parser.add_argument("--track")
    asked = parser.parse_args()
    assert CARD is not None
    for track in [asked.track] if asked.track else CARD.track_ids:
        application = make_application(track)
        if asked.what == "rates":
            print("|", " | ".join([track, *rates(application)]), "|", flush=True)
            continue
        print(f"\n{track}: of {EACH} flights, at the low end and at the high end")
        for row in apart(application):
            print("|", row, "|", flush=True)


if __name__ == "__main__":
    main()
