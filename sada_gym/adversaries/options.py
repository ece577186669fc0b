"""How an adversary declares its options: once, as a frozen dataclass that checks its fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any, TypeVar

from sada_gym.errors import UserError, refuse_unknown

T = TypeVar("T")
Chosen = TypeVar("Chosen", bound="Options")

_RULE = "rule"
_NAMES = {int: "an int", float: "a float", bool: "true or false", str: "a text"}


@dataclass(frozen=True)
class Rule:
    """What an option may be.

    Attributes:
        kind: The type: int, float, bool or str; of each item where there are many.
        low: The least value; None for any.
        high: The greatest value; None for any.
        inside: Whether `low` and `high` themselves are refused.
        choices: The texts allowed; none for any.
        most: The most items of a tuple; 0 where the option is no tuple.
        optional: Whether None is allowed.
    """

    kind: type
    low: float | None = None
    high: float | None = None
    inside: bool = False
    choices: tuple[str, ...] = ()
    most: int = 0
    optional: bool = False

    def allows(self, value: Any) -> bool:
        """Tell whether a value of the right type is in range."""
        if self.choices:
            return value in self.choices
        if self.kind not in (int, float):
            return True
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        if isinstance(value, float) and not math.isfinite(value):
            return False
        return bool(low < value < high if self.inside else low <= value <= high)

    def __str__(self) -> str:
        """Say it as a part of a sentence: `an int from 1 to 100`."""
        one = f"one of {', '.join(self.choices)}" if self.choices else _NAMES[self.kind]
        if self.low is not None and self.high is not None:
            ends = f"{_number(self.low)} {{}} {_number(self.high)}"
            between = f" between {ends.format('and')}, both excluded"
            one += between if self.inside else f" from {ends.format('to')}"
        if self.most:
            one = f"a list of 1 to {self.most} items, each {one}"
        return f"{one}, or None" if self.optional else one


def option(
    default: T,
    low: float | None = None,
    high: float | None = None,
    *,
    kind: type | None = None,
    inside: bool = False,
    choices: tuple[str, ...] = (),
    most: int = 64,
) -> T:
    """Declare an option as a field of `Options`: its default and what it may be.

    Args:
        default: The default; its type is the option's. None allows None beside `kind`.
        low: The least value of a number, or of each number of a tuple.
        high: The greatest. Choose one that no user will miss and that memory can bear.
        kind: The type where the default is None.
        inside: Whether `low` and `high` themselves are refused.
        choices: The texts allowed; none for any.
        most: The most items of a tuple.
    """
    found = _rule_of(default, kind, most)
    rule = replace(found, low=low, high=high, inside=inside, choices=choices)
    declared: T = field(default=default, metadata={_RULE: rule})
    return declared


@dataclass(frozen=True)
class Options:
    """The options of an adversary: none. Subclass it, as a frozen dataclass, to declare some.

    A field may be a plain one, `width: float = 0.1`, whose type is checked, or an `option`,
    whose range is checked as well.

    Raises:
        ValueError: If an option is of another type than declared, or out of range.
    """

    def __post_init__(self) -> None:
        """Check every option; whole numbers become floats, and lists tuples, where declared so."""
        for declared in fields(self):
            value = _checked(declared, getattr(self, declared.name))
            object.__setattr__(self, declared.name, value)

    def as_dict(self) -> dict[str, Any]:
        """Give the options by name: what makes equal ones."""
        return {declared.name: getattr(self, declared.name) for declared in fields(self)}


def choose_options(
    adversary: str,
    default: Chosen,
    presets: Mapping[str, Chosen],
    preset: str,
    given: Mapping[str, Any],
) -> Chosen:
    """Give a preset's options with some of them replaced.

    Args:
        adversary: The adversary's name, for what is said of a mistake.
        default: The options where there are no presets.
        presets: The named sets of options.
        preset: The name of the one to start from.
        given: Single options.

    Raises:
        ValueError: If the preset or an option is unknown, or a value is bad.
    """
    if not presets and preset != "default":
        raise UserError(f"Expected no preset with {adversary}, which has none; drop it.")
    if presets:
        refuse_unknown("preset", [preset], list(presets))
        default = presets[preset]
    refuse_unknown(f"option of {adversary}", given, [field.name for field in fields(default)])
    return replace(default, **given)


def _rule_of(default: Any, kind: type | None, most: int) -> Rule:
    if isinstance(default, tuple):
        return Rule(kind or type(default[0]), most=most)
    return Rule(kind or type(default), optional=default is None)


def _checked(declared: Field[Any], value: Any) -> Any:
    rule = declared.metadata.get(_RULE)
    if rule is None:
        if type(declared.default) not in _NAMES:
            return value
        rule = _rule_of(declared.default, None, 0)
    if value is None and rule.optional:
        return None
    items = _items(value, rule)
    if items is None or not all(map(rule.allows, items)):
        example = f", such as {declared.default}" if declared.default is not None else ""
        raise UserError(f"Expected {declared.name} to be {rule}{example}; got {value!r}.")
    return items if rule.most else items[0]


def _items(value: Any, rule: Rule) -> tuple[Any, ...] | None:
    """Give a value's items in the rule's type, or None where they are of another one."""
    many = isinstance(value, list | tuple)
    if many != bool(rule.most) or (many and not 1 <= len(value) <= rule.most):
        return None
    items = tuple(_cast(item, rule.kind) for item in (value if many else (value,)))
    return None if any(item is None for item in items) else items


def _cast(value: Any, kind: type) -> Any:
    """Give a value as an int, float, bool or str, or None where it is of another type."""
    if kind in (bool, str):
        return value if isinstance(value, kind) else None
    if isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool):
        try:
            return kind(value)
        except OverflowError:  # an int beyond all floats
            return math.inf
    return None


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"
