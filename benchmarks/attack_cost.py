"""What the diagnosis, the list of failures and the report add to an attack, in one run.

    OMP_NUM_THREADS=1 python -m benchmarks.attack_cost

Each attack asks 1,000 queries by level-set and draws its pictures. Processor time counts, so that
other programs matter less; what a part takes is compared with the attack without all of them.
A privileged agent, where there is one, stands apart: what it costs depends on the agent.
"""

from __future__ import annotations

import argparse
import functools
import pkgutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from examples import cartpole
from sada_gym import attack, make_application
from sada_gym.application import Application

PARTS = {
    "diagnosis": ("sada_gym.analyses.diagnose:find_weaknesses",),
    "failures": ("sada_gym.analyses.diagnose:list_failures", "sada_gym.analyses.diagnose:tell"),
    "report": ("sada_gym.attacks:report_attack",),
    "privileged agent": ("sada_gym.experiment.algorithm:feasible_worlds",),
}


def cart_pole() -> Application:
    return cartpole.make_application(cartpole.train())


APPLICATIONS: dict[str, Callable[[], Application]] = {
    "SADA-Digits-3-v0": functools.partial(make_application, "SADA-Digits-3-v0"),
    "SADA-Robot-v0": functools.partial(make_application, "SADA-Robot-v0"),
    "SADA-Driving-OneCurve-v0": functools.partial(make_application, "SADA-Driving-OneCurve-v0"),
    "CartPole-v1": cart_pole,
}


@contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Add up the process seconds of each part."""
    spent = dict.fromkeys(PARTS, 0.0)

    def watch(part: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        start = time.process_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent[part] += time.process_time() - start

    with ExitStack() as stack:
        for part, names in PARTS.items():
            for name in names:
                module, _, function = name.partition(":")
                place = pkgutil.resolve_name(module)
                watched = functools.partial(watch, part, getattr(place, function))
                stack.enter_context(mock.patch.object(place, function, watched))
        yield spent


def measure(application: Application, budget: int) -> tuple[float, dict[str, float]]:
    """Attack, and return the process seconds of all of it, and of each part."""
    dimension = len(application.parameters)
    application.evaluate(np.zeros((1, dimension), np.float32), [0])  # compiles kernels
    with tempfile.TemporaryDirectory() as folder, timed() as spent:
        start = time.process_time()
        attack(application, "level-set", budget=budget, out=Path(folder) / "run", progress=False)
        return time.process_time() - start, spent


def main() -> None:
    """Print a row for each application."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[*APPLICATIONS])
    parser.add_argument("--budget", type=int, default=1_000)
    options = parser.parse_args()
    *parts, privileged = PARTS
    heads = " | ".join([*parts, "together", privileged])
    print(f"| {options.budget:,} queries | attack without | {heads} |")
    print("| --- | --- |" + len(PARTS) * " --- |" + " --- |")
    for name in options.names:
        total, spent = measure(APPLICATIONS[name](), options.budget)
        without = total - sum(spent.values())
        *own, other = (100 * part / without for part in spent.values())
        shares = " | ".join(f"{share:.1f} %" for share in (*own, sum(own), other))
        print(f"| {name} | {without:.0f} s | {shares} |", flush=True)


if __name__ == "__main__":
    main()
