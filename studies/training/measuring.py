"""The scripts that measure agents share these: options, uniform mu, rates in Markdown."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from sada_gym import agents
from sada_gym.application import Application, Outcomes
from sada_gym.measures.rates import wilson_interval
from sada_gym.parameters import Mu


def parse_agent(
    parser: argparse.ArgumentParser, application: str
) -> tuple[argparse.Namespace, Any]:
    """Read a measuring script's options; end the script with a sentence if they cannot be used.

    Args:
        parser: It may have options of its own.
        application: The agent's, such as `SADA-Driving`.

    Returns:
        The options, with `agent` and `seed` among them, and the agent.
    """
    known = ", ".join(agents.names(application))
    parser.add_argument("agent", help=f"{known}, or a .safetensors file of weights")
    parser.add_argument("--seed", type=int, default=1_000)
    options = parser.parse_args()
    try:
        return options, agents.load(options.agent, application)
    except ValueError as error:
        parser.error(str(error))


def evaluate_uniform(
    application: Application, count: int, rng: np.random.Generator, *, spread: float = 1.0
) -> tuple[Mu, list[int], Outcomes]:
    """Evaluate uniform mu within [-spread, spread], each with a seed of its own.

    Returns:
        mu (count, d), the seeds, and what the evaluations gave.
    """
    mu = rng.uniform(-spread, spread, (count, len(application.parameters))).astype(np.float32)
    seeds: list[int] = rng.integers(2**31, size=count).tolist()
    return mu, seeds, application.evaluate(mu, seeds)


def rate(successes: int, trials: int) -> str:
    """Write a rate with its 95 % interval, such as `10.0 % (7.7 to 12.9)`."""
    low, high = wilson_interval(successes, trials)
    return f"{100 * successes / trials:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
