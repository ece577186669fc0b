"""The table of the adversaries, and how one is made by its name."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from sada_gym.adversaries.base import Adversary
from sada_gym.errors import UserError, check_known
from sada_gym.foundations.parts import find_part

_TABLE: dict[str, str] = {
    "random": "sada_gym.adversaries.random:Random",
    "memorise": "sada_gym.adversaries.memorise:Memorise",
    "gaussian": "sada_gym.adversaries.gaussian_mixture:Gaussian",
    "gmm10": "sada_gym.adversaries.gaussian_mixture:GMM10",
    "gmm50": "sada_gym.adversaries.gaussian_mixture:GMM50",
    "svm": "sada_gym.adversaries.svm:SVM",
    "gp": "sada_gym.adversaries.gp:GP",
    "bayesian": "sada_gym.adversaries.bayesian:Bayesian",
    "bbgan": "sada_gym.adversaries.bbgan:BBGAN",
    "bbgan-boost": "sada_gym.adversaries.bbgan:BoostedBBGAN",
    "cross-entropy": "sada_gym.adversaries.cross_entropy:CrossEntropy",
    "smc": "sada_gym.adversaries.smc:SMC",
    "cma-mae": "sada_gym.adversaries.cma_mae:CMAMAE",
    "reinforce": "sada_gym.adversaries.reinforce:Reinforce",
    "ppo": "sada_gym.adversaries.rl_sb3:PPO",
    "sac": "sada_gym.adversaries.rl_sb3:SAC",
    "td3": "sada_gym.adversaries.rl_sb3:TD3",
    "trees": "sada_gym.adversaries.trees:Trees",
    "level-set": "sada_gym.adversaries.level_set:LevelSet",
}

_PACKAGES = {"cma-mae": "ribs"}
"""The optional packages that adversaries need, by the adversary's name."""


@dataclass(frozen=True)
class Description:
    """An adversary's name and summary, the names of its presets, and its options' defaults."""

    name: str
    summary: str
    presets: tuple[str, ...]
    options: dict[str, Any]


def names() -> list[str]:
    """List the names of the shipped adversaries."""
    return list(_TABLE)


def missing_package(name: str) -> str | None:
    """Return the optional package that an adversary needs and that is not installed, if any."""
    package = _PACKAGES.get(name)
    return None if package is None or importlib.util.find_spec(package) else package


def make(name: str, dimension: int, *, seed: int | None = None, **options: Any) -> Adversary:
    """Make an adversary by its name, one of `names()`, or your own by `module:Class`.

    `options` are the keywords of this adversary, and `preset` if it has presets. See `Adversary`.

    Raises:
        ValueError: If the name or an option is unknown, or a value is bad.
    """
    kind = find(name)
    if "preset" in options and not kind.presets:
        raise UserError(f"Expected no preset with {name}, which has none; drop it.")
    check_known(f"option of {name}", options, list(_options(kind)))
    return kind(dimension, seed=seed, **options)


def resolve(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return all options that `make` would use: `options`, and the preset's for all others.

    Raise `UserError` if the name or the preset is unknown.
    """
    kind = find(name)
    chosen = options.get("preset", "default")
    if kind.presets:
        check_known("preset", [chosen], list(kind.presets))
    return {**_options(kind, chosen), **options}


def describe() -> list[Description]:
    """Describe every shipped adversary. This imports all of them, and PyTorch."""
    rows = []
    for name in _TABLE:
        kind = find(name)
        summary = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
        rows.append(Description(name, summary, tuple(kind.presets), _options(kind)))
    return rows


def find(name: str) -> type[Adversary]:
    """Import the class of an adversary by its name, or by `module:Class`.

    Raises:
        ValueError: If there is no such adversary, or its module cannot be imported.
    """
    kind = find_part("adversary", name, _TABLE)
    if not (isinstance(kind, type) and issubclass(kind, Adversary)):
        raise UserError(f"Expected {name!r} to be a subclass of Adversary, got {kind!r}.")
    return kind


def _options(kind: type[Adversary], preset: str = "default") -> dict[str, Any]:
    options = {
        p.name: None if p.default is p.empty else p.default
        for p in inspect.signature(kind).parameters.values()
        if p.kind is p.KEYWORD_ONLY and p.name != "seed" and (p.name != "preset" or kind.presets)
    }
    start = kind.presets[preset] if kind.presets else kind.options_class()
    return options | {field.name: getattr(start, field.name) for field in fields(start)}
