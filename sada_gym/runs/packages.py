"""Which packages a run's result depends on: those that its application and adversary load."""

from __future__ import annotations

import functools
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from typing import Any

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.envs.catalogue import cards

version = functools.cache(metadata.version)  # which parses a file each time

_ORDER = (
    "python",
    "sada_gym",
    "gymnasium",
    "numpy",
    "scipy",
    "scikit-learn",
    "torch",
    "stable-baselines3",
    "pybullet",
    "highway-env",
    "pymunk",
    "trimesh",
    "numba",
    "ribs",
    "pillow",
)
_EVERY_RUN = ("sada_gym", "gymnasium", "numpy", "scipy")
_OF_ADVERSARY: Mapping[str, tuple[str, ...]] = {
    "ideal": (),
    "random": (),
    "archive": (),
    "gp": (),
    "gaussian": ("scikit-learn",),
    "gmm10": ("scikit-learn",),
    "gmm50": ("scikit-learn",),
    "svm": ("scikit-learn",),
    "bayesian": ("scikit-learn",),
    "bbgan": ("torch",),
    "bbgan-boost": ("torch",),
    "cross-entropy": ("scikit-learn",),
    "smc": ("scikit-learn",),
    "cma-mae": ("scikit-learn", "torch", "numba", "ribs"),
    "reinforce": ("scikit-learn", "torch"),
    **dict.fromkeys(("ppo", "sac", "td3"), ("scikit-learn", "torch", "stable-baselines3")),
    "sada": ("scikit-learn",),
    "trees": ("scikit-learn",),
    "level-set": ("scikit-learn",),
}


def packages(application: Application, adversary: type[Adversary]) -> dict[str, str]:
    """Give the versions of Python and of those packages that can change a run's result.

    A class of a user's own may name its packages in an attribute `packages`, a tuple of names as
    pip knows them. Without it all the packages count that any of our own needs.

    Args:
        application: What is attacked.
        adversary: The adversary's class.
    """
    names = {
        *_EVERY_RUN,
        *_declared(application, {card.name: card.packages for card in cards()}),
        *_declared(adversary, _OF_ADVERSARY),
    }
    found = {"python": platform.python_version()}
    for name in names:
        try:
            found[name] = version(name)
        except metadata.PackageNotFoundError:
            continue
    return in_order(found)


def in_order(found: Mapping[str, str]) -> dict[str, str]:
    """Sort versions by package: the ones that we know in a fixed order, others by name."""
    known: Iterable[str] = (name for name in _ORDER if name in found)
    others = sorted(name for name in found if name not in _ORDER)
    return {name: found[name] for name in (*known, *others)}


def _declared(owner: Any, table: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    declared: tuple[str, ...] | None = getattr(owner, "packages", None)
    if declared is not None:
        return tuple(declared)
    module = (owner if isinstance(owner, type) else type(owner)).__module__
    ours = module.partition(".")[0] == "sada_gym"
    return table[owner.name] if ours and owner.name in table else _ORDER[1:]
