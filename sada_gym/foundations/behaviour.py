"""What an agent did in worlds: in words, as plain data, and counted over many of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from typing_extensions import Self

from sada_gym.foundations.figures import number
from sada_gym.foundations.files import OneLine, Strict, shown

Plain = bool | int | float | str
"""A value that failures and passes can be compared by."""

MOST_NAMED = 3
"""So many things are named; the rest is counted."""

_MOST_VALUES, _LONGEST_TEXT = 50, 40
_FEWEST_COMPARED = 3
_APART, _APART_RANKS = 0.5, 0.95


@dataclass(frozen=True)
class Behaviour:
    """What the agent did in one world.

    Attributes:
        text: A few words, such as `seen as bus (0.83)`.
        events: What went wrong: a few words, which are counted, for each part of the world that
            failed, such as one of five drives. Empty if nothing went wrong.
        part: What a part is called, such as `drive`; `world` if there is only one part.
        data: The same as data for JSON. Diagnoses compare its numbers, truth values and texts
            between failures and passes.
    """

    text: str
    events: tuple[str, ...] = ()
    part: str = "world"
    data: Mapping[str, Any] = field(default_factory=dict)


class Event(Strict):
    """Something that went wrong, and how often."""

    text: OneLine
    count: int


class Behaviours(Strict):
    """What the agent did in some worlds in which it failed.

    Attributes:
        worlds: The number of worlds that were played again.
        part: What a part of a world is called, such as `drive`; `world` if it has only one.
        failed: The number of parts that failed.
        events: What went wrong, the most frequent event first.
        differences: How these worlds differ from worlds in which the agent passed.
    """

    worlds: int
    part: OneLine
    failed: int
    events: tuple[Event, ...]
    differences: tuple[OneLine, ...] = ()

    @classmethod
    def of(cls, failures: Sequence[Behaviour], passes: Sequence[Behaviour] = ()) -> Self | None:
        """Count what the agent did in failures; None if there are no events and no differences."""
        counts = Counter(shown(event) for failure in failures for event in failure.events)
        told = differences(failures, passes)
        if not counts and not told:
            return None
        part = next((failure.part for failure in failures if failure.events), "world")
        return cls(
            worlds=len(failures),
            part=part,
            failed=len(failures) if part == "world" else counts.total(),
            events=tuple(Event(text=text, count=count) for text, count in counts.most_common()),
            differences=told,
        )

    @property
    def sentence(self) -> str:
        """A summary, such as `seen as bus in 7 of 10 worlds, nothing seen in 3`."""
        named, others = self.events[:MOST_NAMED], self.events[MOST_NAMED:]
        counted = [f"{event.text} in {event.count}" for event in named]
        if counted:
            failed = "" if self.part == "world" else "failed "
            plural = "" if self.failed == 1 else "s"
            counted[0] += f" of {self.failed:,} {failed}{self.part}{plural}"
        if others:
            counted.append(f"something else in {sum(event.count for event in others)}")
        return "; ".join([", ".join(counted)] * bool(counted) + [*self.differences])


def differences(failures: Sequence[Behaviour], passes: Sequence[Behaviour]) -> tuple[str, ...]:
    """Say which data of failures differ most from those of passes, at most three.

    These are truth values and texts that half of the worlds more have than of the others, and
    numbers that are greater (or less) in 19 of 20 pairs of a failure and a pass. Nothing is said by
    fewer than three worlds of either kind.
    """
    if min(len(failures), len(passes)) < _FEWEST_COMPARED:
        return ()
    differing = []
    for name in failures[0].data:
        ours: list[Any] = [failure.data.get(name) for failure in failures]
        others: list[Any] = [other.data.get(name) for other in passes]
        values = [*ours, *others]
        if all(isinstance(value, bool) for value in values):
            differing.append(_shares(name, True, ours, others))
        elif all(isinstance(value, str) for value in values):
            (commonest, _), *_ = Counter(ours).most_common(1)
            differing.append(_shares(name, commonest, ours, others))
        elif all(isinstance(value, int | float) for value in values):
            differing.append(_ranks(name, ours, others))
    apart = sorted((pair for pair in differing if pair is not None), key=lambda pair: -pair[0])
    return tuple(text for _, text in apart[:MOST_NAMED])


def plain_values(info: Mapping[Any, Any], prefix: str = "") -> dict[str, Plain]:
    """Return the numbers, truth values and short texts of an info, and of dictionaries in it."""
    found: dict[str, Plain] = {}
    for name, value in _flat(info, prefix, nested=True):
        if len(found) == _MOST_VALUES:
            break
        if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
            value = value.item()
        is_finite = isinstance(value, int | float) and bool(np.isfinite(np.float64(value)))
        if is_finite or (isinstance(value, str) and 0 < len(value) <= _LONGEST_TEXT):
            found[name] = shown(value) if isinstance(value, str) else value
    return found


def listed_events(
    events: Sequence[tuple[str, str]], parts: int, part: str, fine: str
) -> tuple[str, tuple[str, ...]]:
    """Sum up the parts of a world that failed, of so many, each with its words and its event.

    Returns:
        The text, `fine` where no part failed, and the events, see `Behaviour`.
    """
    if not events:
        return fine, ()
    named = [words for words, _ in events[:MOST_NAMED]]
    more = len(events) - len(named)
    text = f"{len(events)} of {parts} {part}s failed: {'; '.join(named)}"
    return text + (f"; and {more} more" if more else ""), tuple(event for _, event in events)


def _flat(info: Mapping[Any, Any], prefix: str, *, nested: bool) -> Iterator[tuple[str, Any]]:
    for key, value in info.items():
        name = f"{prefix}{shown(str(key))}"
        if nested and isinstance(value, Mapping):
            yield from _flat(value, f"{name}.", nested=False)
        else:
            yield name, value


def _shares(
    name: str, value: Plain, ours: Sequence[Any], others: Sequence[Any]
) -> tuple[float, str] | None:
    here, there = ours.count(value), others.count(value)
    apart = here / len(ours) - there / len(others)
    if abs(apart) < _APART:
        return None
    what = name if value is True else f"{name} {shown(str(value))}"
    text = f"{what} in {here} of {len(ours)} failures, in {there} of {len(others)} passes"
    return 1.0 + abs(apart), text


def _ranks(name: str, ours: Sequence[Any], others: Sequence[Any]) -> tuple[float, str] | None:
    below = np.subtract.outer(np.array(ours, np.float64), np.array(others, np.float64))
    share = float((below < 0).mean() + (below == 0).mean() / 2)
    if max(share, 1.0 - share) < _APART_RANKS:
        return None
    medians = (float(np.median(np.array(part, np.float64))) for part in (ours, others))
    here, there = map(number, medians)
    return max(share, 1.0 - share), f"{name} {here} in failures, {there} in passes (medians)"
