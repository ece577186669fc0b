"""The adversaries by name. Importing this loads none of them, and no torch."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.errors import UserError

__all__ = ["Adversary", "Description", "Query", "describe", "make", "names", "resolve"]

_TABLE: dict[str, str] = {
    "random": "sada_gym.adversaries.random:Random",
    "archive": "sada_gym.adversaries.archive:Archive",
    "gaussian": "sada_gym.adversaries.gaussian_mixture:Gaussian",
    "gmm10": "sada_gym.adversaries.gaussian_mixture:GMM10",
    "gmm50": "sada_gym.adversaries.gaussian_mixture:GMM50",
    "svm": "sada_gym.adversaries.svm:SVM",
    "gp": "sada_gym.adversaries.gp:GP",
    "bayesian": "sada_gym.adversaries.bayesian:Bayesian",
    "bbgan": "sada_gym.adversaries.bbgan:BBGAN",
    "bbgan-boost": "sada_gym.adversaries.bbgan_boost:BoostedBBGAN",
    "cross-entropy": "sada_gym.adversaries.cross_entropy:CrossEntropy",
    "smc": "sada_gym.adversaries.smc:SMC",
    "cma-mae": "sada_gym.adversaries.cma_mae:CMAMAE",
    "sada": "sada_gym.adversaries.sada:SADA",
}


@dataclass(frozen=True)
class Description:
    """A row of the table of adversaries.

    Attributes:
        name: As on the command line.
        summary: One sentence.
        presets: The named sets of options.
        options: The options and their defaults.
    """

    name: str
    summary: str
    presets: tuple[str, ...]
    options: dict[str, Any]


def names() -> list[str]:
    """List the adversaries' names."""
    return list(_TABLE)


def make(name: str, dimension: int, *, seed: int | None = None, **options: Any) -> Adversary:
    """Make an adversary by its name.

    Args:
        name: One of `names()`, or `module:Class` for an adversary of one's own.
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness; None draws one.
        options: The adversary's own, `preset` among them where it has presets.

    Raises:
        ValueError: If the name, an option or its value is unknown or bad.
    """
    kind = _class(name)
    if "preset" in options and not hasattr(kind, "presets"):
        raise UserError(f"Expected no preset with {name}, which has none; drop it.")
    refuse_unknown(f"option of {name}", options, list(_options(kind)))
    return kind(dimension, seed=seed, **options)


def resolve(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Give all options that `make` would use: those given, the preset's, the defaults.

    Args:
        name: As of `make`.
        options: The adversary's own, `preset` among them where it has presets.

    Raises:
        ValueError: If the name or the preset is unknown.
    """
    kind = _class(name)
    presets = getattr(kind, "presets", {})
    chosen = options.get("preset", "default")
    if presets:
        refuse_unknown("preset", [chosen], list(presets))
    return {**_options(kind, chosen), **options}


def describe() -> list[Description]:
    """Describe every adversary. It loads them all, torch included."""
    rows = []
    for name in _TABLE:
        kind = _class(name)
        summary = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
        rows.append(Description(name, summary, tuple(getattr(kind, "presets", ())), _options(kind)))
    return rows


def refuse_unknown(what: str, given: Any, known: list[str]) -> None:
    """Raise ValueError for the first of the given names that is not known, with close matches."""
    for name in given:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=3)
            hint = f" Did you mean {' or '.join(close)}?" if close else ""
            listed = f"one of {', '.join(known)}" if known else "none"
            raise UserError(f"Expected the {what} to be {listed}; got {name!r}.{hint}")


def _class(name: str) -> type[Adversary]:
    if ":" not in name:
        refuse_unknown("adversary", [name], names())
    module, _, attribute = _TABLE.get(name, name).partition(":")
    try:
        kind = getattr(importlib.import_module(module), attribute)
    except (ModuleNotFoundError, AttributeError) as error:
        raise UserError(
            f"Expected an adversary's name or module:Class, got {name!r} ({error}). Install the "
            "module, or set PYTHONPATH to the folder that holds it."
        ) from error
    if not (isinstance(kind, type) and issubclass(kind, Adversary)):
        raise UserError(f"Expected {name!r} to be a subclass of Adversary, got {kind!r}.")
    return kind


def _options(kind: type[Adversary], preset: str = "default") -> dict[str, Any]:
    """Give an adversary's options and their defaults: keywords, and the fields of its preset."""
    options = {
        p.name: None if p.default is p.empty else p.default
        for p in inspect.signature(kind).parameters.values()
        if p.kind is p.KEYWORD_ONLY and p.name != "seed"
    }
    presets = getattr(kind, "presets", {})
    if presets:
        default = presets[preset]
        options |= {field.name: getattr(default, field.name) for field in fields(default)}
    return options
