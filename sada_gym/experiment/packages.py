"""Which packages a run's result depends on: those that its application and adversary load."""

from __future__ import annotations

import functools
import platform
from collections.abc import Mapping
from contextlib import suppress
from importlib import metadata

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.foundations.arithmetic import arithmetic, warn_of_others
from sada_gym.foundations.cards import find_card

ARITHMETIC = "arithmetic"

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
    "carla",
    "trimesh",
    "numba",
    "ribs",
    "pillow",
    "opencv-python",
    "opencv-python-headless",
    "onnxruntime",
    "mujoco",
    "jsbsim",
    "metadrive-simulator",
    "foundation-policy",
    "h5py",
)
_EVERY_RUN = ("sada_gym", "gymnasium", "numpy", "scipy")
_UNDECLARED = tuple(name for name in _ORDER[1:] if name != "onnxruntime")
"""What counts for a class that says nothing: an agent of ONNX says it itself."""


def packages(application: Application, adversary: type[Adversary]) -> dict[str, str]:
    """Return the versions of Python and of those packages that can change a run's result.

    `arithmetic` among them says with which kernels they compute, see `foundations.arithmetic`.

    A class of a user's own may name its packages in an attribute `packages`, a tuple of names as
    pip knows them. Without it all the packages count that any of our own needs.
    """
    names = {*_EVERY_RUN, *_of_application(application), *_of_adversary(adversary)}
    names.update(getattr(application.agent, "packages", ()))
    versions = {"python": platform.python_version()}
    for name in names:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = version(name)
    versions[ARITHMETIC] = arithmetic()
    warn_of_others(versions[ARITHMETIC])
    if "onnxruntime" in names:
        versions[ARITHMETIC] += ", and this processor's own of onnxruntime"
    return in_order(versions)


def installed(name: str) -> str:
    """Return what an entry of `packages` is here; `not installed` without that package."""
    if name == "python":
        return platform.python_version()
    if name == ARITHMETIC:
        return arithmetic()
    try:
        return version(name)
    except (metadata.PackageNotFoundError, ValueError):  # a name that no package has
        return "not installed"


def in_order(versions: Mapping[str, str]) -> dict[str, str]:
    """Sort versions by package: the ones that we know in a fixed order, others by name."""
    known = [name for name in _ORDER if name in versions]
    others = sorted(name for name in versions if name not in _ORDER)
    return {name: versions[name] for name in (*known, *others)}


def _of_application(application: Application) -> tuple[str, ...]:
    declared: tuple[str, ...] | None = getattr(application, "packages", None)
    if declared is not None:
        return tuple(declared)
    card = find_card(application.name) if _is_ours(type(application)) else None
    return _UNDECLARED if card is None else card.packages


def _of_adversary(adversary: type[Adversary]) -> tuple[str, ...]:
    """Return what an adversary's class or one of its bases declares.

    A class of a user's own may need more than the class of ours that it derives from, so it does
    not inherit our declaration.
    """
    bases = (base for base in adversary.__mro__ if "packages" in vars(base))
    declared = next(bases, None)
    if declared is None or _is_ours(declared) != _is_ours(adversary):
        return _UNDECLARED
    return tuple(adversary.packages)


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "sada_gym"
