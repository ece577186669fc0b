"""How an adversary declares its options: once, as a frozen dataclass that checks its fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any, TypeVar

from sada_gym.errors import UserError, check_known

T = TypeVar("T")
Chosen = TypeVar("Chosen", bound="Options")

_RULE = "rule"
_NAMES = {int: "an int", float: "a float", bool: "true or false", str: "a text"}
_NUMBERS: Mapping[type, type] = {int: Integral, float: Real}


@dataclass(frozen=True)
class Rule:
    """What an option may be. `option` explains the fields; `optional` allows None."""

    kind: type
    low: float | None = None
    high: float | None = None
    inside: bool = False
    choices: tuple[str, ...] = ()
    max_items: int = 0
    optional: bool = False

    def accept(self, value: Any) -> Any:
        """Return an allowed value in the rule's type; raise a bare ValueError for any other."""
        if value is None and self.optional:
            return None
        if not self.max_items:
            return self._accept_one(value)
        if not isinstance(value, list | tuple) or not 1 <= len(value) <= self.max_items:
            raise ValueError
        return tuple(map(self._accept_one, value))

    def _accept_one(self, value: Any) -> Any:
        wanted = _NUMBERS.get(self.kind, self.kind)
        if not isinstance(value, wanted) or isinstance(value, bool) != (self.kind is bool):
            raise ValueError
        value = self.kind(value)
        if self.choices and value not in self.choices:
            raise ValueError
        if self.kind in _NUMBERS:
            low = -math.inf if self.low is None else self.low
            high = math.inf if self.high is None else self.high
            within = low < value < high if self.inside else low <= value <= high
            if not (math.isfinite(value) and within):
                raise ValueError
        return value

    def __str__(self) -> str:
        """Say it as a part of a sentence: `an int from 1 to 100`."""
        rule = f"one of {', '.join(self.choices)}" if self.choices else _NAMES[self.kind]
        if self.low is not None and self.high is not None:
            ends = self.low, self.high
            low, high = (f"{n:,}" if isinstance(n, int) else f"{n:g}" for n in ends)
            between = f" between {low} and {high}, both excluded"
            rule += between if self.inside else f" from {low} to {high}"
        if self.max_items:
            rule = f"a list of 1 to {self.max_items} items, each {rule}"
        return f"{rule}, or None" if self.optional else rule


def option(
    default: T,
    low: float | None = None,
    high: float | None = None,
    *,
    kind: type | None = None,
    inside: bool = False,
    choices: tuple[str, ...] = (),
    max_items: int = 64,
) -> T:
    """Declare an option as a field of `Options`: its default and what it may be.

    The type is that of the default. With None as the default, it is `kind`, and None is allowed. A
    tuple means a list of 1 to `max_items` items. A number, or each number of a list, must lie in
    [low, high], or in (low, high) with `inside=True`. Choose `high` large enough for every user,
    but not so large that memory runs out. A text must be one of the `choices`, if there are any.
    """
    several = isinstance(default, tuple)
    kind = kind or type(default[0] if isinstance(default, tuple) else default)
    rule = Rule(kind, low, high, inside, choices, max_items * several, optional=default is None)
    return field(default=default, metadata={_RULE: rule})


@dataclass(frozen=True)
class Options:
    """The options of an adversary. To declare yours, write a subclass that is a frozen dataclass.

    Of a plain field, such as `width: float = 0.1`, the type is checked; of an `option`, the range
    is checked, too.

    Raises:
        ValueError: If an option is of another type than declared, or out of range.
    """

    def __post_init__(self) -> None:
        """Check every option; whole numbers become floats, and lists tuples, where declared so."""
        for declared in fields(self):
            value = _validate(declared, getattr(self, declared.name))
            object.__setattr__(self, declared.name, value)

    def as_dict(self) -> dict[str, Any]:
        """Return the options by name; passed to the class, they make equal options."""
        return {declared.name: getattr(self, declared.name) for declared in fields(self)}


def choose_options(
    adversary: str,
    default: Chosen,
    presets: Mapping[str, Chosen],
    preset: str,
    given: Mapping[str, Any],
) -> Chosen:
    """Return a preset's options, or the default where there are none, and replace those given.

    Raises:
        ValueError: If the preset or an option is unknown, or a value is bad.
    """
    if not presets and preset != "default":
        raise UserError(f"Expected no preset with {adversary}, which has none; drop it.")
    if presets:
        check_known("preset", [preset], list(presets))
        default = presets[preset]
    check_known(f"option of {adversary}", given, [field.name for field in fields(default)])
    return replace(default, **given)


def _validate(declared: Field[Any], value: Any) -> Any:
    kind = type(declared.default)
    if _RULE not in declared.metadata and kind not in _NAMES:
        return value
    rule = declared.metadata.get(_RULE, Rule(kind))
    try:
        return rule.accept(value)
    except (ValueError, OverflowError) as error:  # an int beyond all floats overflows
        example = f", such as {declared.default}" if declared.default is not None else ""
        raise UserError(
            f"Expected {declared.name} to be {rule}{example}; got {value!r}."
        ) from error
