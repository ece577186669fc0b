"""Several requirements of an episode as one score: it fails where it fails one of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.scores import Episode, Return, Score, as_score
from sada_gym.errors import UserError, UserTypeError, check_known, check_plain

EDGE = 0.5
"""Where the threshold of each requirement lies in its margin, and so the fooling threshold."""


@dataclass(frozen=True)
class Several(Score):
    """The worst of several scores, each by its margin to its own threshold.

    A margin is 0 where a score Q is 0, `EDGE` at its threshold t, 1 where Q is 1, and linear
    between: `0.5 Q / t` up to the threshold, `0.5 + 0.5 (Q - t) / (1 - t)` above it. So Q <= t
    exactly where the margin is at most `EDGE`, margins of different scores can be compared, and the
    least one is a score with one threshold.

    Attributes:
        scores: By the requirement's name.
        thresholds: By the same names.
        requirement: The one whose margin alone is the score; None takes the least margin.
    """

    scores: Mapping[str, Score]
    thresholds: Mapping[str, float]
    requirement: str | None = None

    def __post_init__(self) -> None:
        """Take over what the scores need."""
        scores = self.scores.values()
        entries = {score.entry for score in scores if isinstance(score, Return)}
        if len(entries) > 1:
            raise UserError(
                "Expected requirements of one entry of the rewards, got ('return', low, high, "
                f"entry) with the entries {sorted(map(str, entries))}. Name the same in each."
            )
        object.__setattr__(self, "entry", next(iter(entries), None))
        for needs in ("keeps_all", "keeps_infos"):
            object.__setattr__(self, needs, any(getattr(score, needs) for score in scores))

    @property
    def settings(self) -> Any:  # noqa: D102
        each = {
            name: [score.settings, float(self.thresholds[name])]
            for name, score in self.scores.items()
        }
        return each if self.requirement is None else [self.requirement, each]

    @property
    def own_functions(self) -> dict[str, Callable[..., Any]]:  # noqa: D102
        return {
            f"{role} of {name!r}": function
            for name, score in self.scores.items()
            for role, function in score.own_functions.items()
        }

    @property
    def probes(self) -> tuple[Callable[..., Any], ...]:  # noqa: D102
        return tuple(probe for score in self.scores.values() for probe in score.probes)

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        return self.judge(episode)[:2]

    def judge(self, episode: Episode) -> tuple[float, bool, dict[str, float]]:  # noqa: D102
        each = {name: score(episode) for name, score in self.scores.items()}
        margins = {name: margin(q, self.thresholds[name]) for name, (q, _) in each.items()}
        counts = self.requirement or min(margins, key=margins.__getitem__)
        return margins[counts], each[counts][1], margins


def margin(score: float, threshold: float) -> float:
    """Return where a score lies: at most `EDGE` exactly where it is at most its threshold."""
    if score <= threshold:
        return EDGE * score / threshold if threshold else 0.0
    above = EDGE + (1.0 - EDGE) * (score - threshold) / (1.0 - threshold)
    return float(min(max(above, np.nextafter(EDGE, 1.0)), 1.0))


def given_score(score: Any, threshold: Any, requirement: str | None) -> tuple[Score, Any]:
    """Return the score that arguments of `GymnasiumApplication` mean, and its threshold.

    Raises:
        UserError: If a score, a threshold or a requirement is not as described.
    """
    if not isinstance(score, Mapping):
        if isinstance(threshold, Mapping) or requirement is not None:
            what = "requirement" if requirement is not None else "fooling_threshold by name"
            raise UserTypeError(
                f"Expected {what} with several scores, score={{'safe': ..., 'smooth': ...}}, got "
                f"score={score!r}."
            )
        return as_score(score), threshold
    for name in score:
        if not isinstance(name, str) or not name:
            raise UserTypeError(f"Expected texts as names of requirements, got {name!r}.")
        check_plain("the name of a requirement", name)
    if not score:
        raise UserError("Expected a score by name, such as {'safe': ('cost', 1)}, got {}.")
    limits = threshold if isinstance(threshold, Mapping) else dict.fromkeys(score, threshold)
    check_known("requirement in fooling_threshold", limits, [*score])
    if missing := [name for name in score if name not in limits]:
        raise UserError(
            f"Expected a threshold of {missing[0]!r} in fooling_threshold, got none. Add it, or "
            "give one number for all."
        )
    for name, limit in limits.items():
        if not is_number(limit) or isinstance(limit, bool) or not 0.0 <= limit < 1.0:
            raise UserError(
                f"Expected the fooling_threshold of {name!r} to be a number from 0 to below 1, "
                f"got {limit!r}."
            )
    if requirement is not None:
        check_known("requirement", [requirement], [*score])
    scores = {name: as_score(given) for name, given in score.items()}
    return Several(scores, {name: limits[name] for name in score}, requirement), EDGE
