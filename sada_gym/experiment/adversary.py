"""Which adversary an experiment trains, with all its options."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import Field
from typing_extensions import Self

from sada_gym import adversaries
from sada_gym.adversaries.base import Adversary
from sada_gym.errors import UserError, UserTypeError, check_keywords
from sada_gym.experiment.ideal import IDEAL, Ideal
from sada_gym.foundations.files import Strict
from sada_gym.parameters import Mu


class AdversarySpec(Strict):
    """An adversary and its options.

    Attributes:
        name: Its registered name, `module:Class`, `ideal`, or the name that its authors gave it.
        preset: The name of its preset, if any.
        options: Its options, without those of the preset.
        resolved: All its options, including defaults; None before `resolve`.
    """

    name: str
    preset: str | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    resolved: dict[str, Any] | None = None

    @classmethod
    def of(
        cls, name: str, preset: str | None = None, options: Mapping[str, Any] | None = None
    ) -> Self:
        """Describe an adversary by its name; raises a TypeError if an argument has another type."""
        if not isinstance(name, str):
            raise UserTypeError(f"Expected an adversary's name, got {name!r}.")
        if preset is not None and not isinstance(preset, str):
            raise UserTypeError(f"Expected a preset's name or None, got {preset!r}.")
        options = {} if options is None else options
        check_keywords("options", options)
        return cls(name=name, preset=preset, options=dict(options))

    @property
    def label(self) -> str:
        """Its name in reports: the name, and the preset if it has one."""
        return self.name if self.preset is None else f"{self.name} ({self.preset})"

    @property
    def is_ours(self) -> bool:
        """Whether the package has an adversary of this name."""
        return self.name == IDEAL or self.name in adversaries.names()

    def resolve(self, *, kind: type[Adversary] | None = None) -> Self:
        """Return a copy with all options filled in, as JSON; your own class (`kind`) has no others.

        Raises:
            TypeError, ValueError: If the name or the preset is unknown, or the options cannot be
                written as JSON.
        """
        options = json_compatible(self.options)
        resolved = options
        if kind is None and self.name != IDEAL:
            resolved = json_compatible(adversaries.resolve(self.name, self._keywords))
        return self.model_copy(update={"options": options, "resolved": resolved})

    def make(
        self,
        dimension: int,
        *,
        seed: int,
        ideal_set: Mu | None,
        kind: type[Adversary] | None = None,
    ) -> Adversary:
        """Make the untrained adversary for d parameters; `ideal` draws from `ideal_set`, (R, d).

        Raises a TypeError or ValueError for an unknown adversary or option.
        """
        taken = sorted({"name", "dimension", "seed"} & set(self.options))
        if taken:
            raise UserError(
                f"Expected the adversary's own options, got {taken[0]!r}, which the run sets "
                "itself."
            )
        if kind is not None:
            return kind(dimension, seed=seed, **self._keywords)
        if self.name != IDEAL:
            return adversaries.make(self.name, dimension, seed=seed, **self._keywords)
        if self._keywords:
            raise UserError(f"Expected {IDEAL} without options, got {self._keywords}. Drop them.")
        if ideal_set is None:
            raise UserError(
                f"Expected {IDEAL} on a track that has a reference set, got one without. Choose "
                "another adversary."
            )
        return Ideal(dimension, seed=seed, fooling_set=ideal_set)

    @property
    def _keywords(self) -> dict[str, Any]:
        return {**({} if self.preset is None else {"preset": self.preset}), **self.options}


def name_and_class(adversary: str | type[Adversary]) -> tuple[str, type[Adversary] | None]:
    """Return an adversary's name, and its class where a user gave that; else a TypeError."""
    if isinstance(adversary, str):
        return adversary, None
    if not (isinstance(adversary, type) and issubclass(adversary, Adversary)):
        raise UserTypeError(f"Expected an adversary's name or class, got {adversary!r}.")
    return adversary.name, adversary


def json_compatible(options: Mapping[str, Any]) -> dict[str, Any]:
    """Copy options as JSON would hold them; a TypeError if they cannot be written so."""
    try:
        copied: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise UserTypeError(
            f"Expected options that can be written as JSON, got {dict(options)!r} ({error}). "
            "Give numbers, strings, lists, None."
        ) from error
    return copied
