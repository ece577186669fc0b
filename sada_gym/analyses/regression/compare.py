"""The paired comparison of two agents on the same worlds and seeds, and what follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any, Literal

from sada_gym.analyses.regression.suite import Case, Verdict
from sada_gym.errors import UserError, UserTypeError, check_integer
from sada_gym.foundations.arrays import Bools
from sada_gym.foundations.files import OneLine, Strict
from sada_gym.measures.likelihood import FailureEstimate, odds

ALPHA = 0.05
"""One-sided: the risk of calling an agent better that is not, and that of a margin's bound."""
FALSE_ALARM = 0.01
"""One-sided: the risk of failing an agent that is no worse, shared among the arms of a suite."""
ORDINARY_MARGIN = 0.05
"""The increase in ordinary worlds that is tolerated where nothing else is said."""

_MOST_WORLDS = 10**6
_MOST_SUITES = 100

Change = Literal[
    "fixed", "regressed", "new failure", "still fails", "still passes", "not comparable"
]
Status = Literal["passed", "failed", "inconclusive"]

_ORDER: tuple[Status, ...] = ("passed", "inconclusive", "failed")
BROKEN: tuple[Change, ...] = ("regressed", "new failure")


class Decision(Strict):
    """Whether an agent passed, and the figures behind it.

    Attributes:
        status: `passed`, `failed` or `inconclusive`.
        reason: The reason, in a sentence.
        worlds: How many worlds could be compared.
        broken: How many worlds passed before and fail now.
        fixed: How many worlds failed before and pass now.
        p_worse: McNemar's exact one-sided p-value of such a surplus of broken worlds.
        p_better: The same for fixed worlds.
        increase: The rate of failing worlds now, minus the rate before.
        at_most: The upper end of this increase at 95 % confidence.
        margin: The largest increase that is tolerated; None if none was given.
        more: At least how many more worlds a decision needs (without a margin: worlds whose verdict
            changed). None if it is decided, or if no number would be enough.
        repeats: How many suites of this size, including this one, would be enough for a decision.
    """

    status: Status
    reason: OneLine
    worlds: int
    broken: int
    fixed: int
    p_worse: float
    p_better: float
    increase: float
    at_most: float
    margin: float | None
    more: int | None = None
    repeats: int | None = None


def verdict_of(fooled: Bools, invalid: Bools) -> Verdict | None:
    """Judge a world by its seeds: it fails where more than half of its valid seeds fool.

    Both arrays are (seeds,) bool. None where no seed is valid.
    """
    valid = int((~invalid).sum())
    if not valid:
        return None
    return "fail" if 2 * int((fooled & ~invalid).sum()) > valid else "pass"


def change_of(case: Case, before: Verdict | None, now: Verdict | None) -> Change:
    """Say what became of a world."""
    if before is None or now is None:
        return "not comparable"
    if before == now:
        return "still fails" if now == "fail" else "still passes"
    if now == "pass":
        return "fixed"
    return "regressed" if case.objective == "failure" else "new failure"


def check_margin(margin: object) -> None:
    """Raise `UserError` for anything but None or a number above 0 and below 1."""
    if margin is None:
        return
    if isinstance(margin, bool) or not isinstance(margin, int | float):
        raise UserTypeError(f"Expected margin to be a number such as 0.05, got {margin!r}.")
    if not 0.0 < margin < 1.0:
        raise UserError(f"Expected a margin above 0 and below 1, such as 0.05, got {margin}.")


def decide(
    changes: Sequence[Change],
    *,
    margin: float | None = None,
    unchanged: bool = False,
    alarm: float = FALSE_ALARM,
    unlucky: tuple[int, int] = (0, 0),
) -> Decision:
    """Decide whether an agent passes.

    The test is McNemar's (1947) in its exact form: if nothing is worse, a world whose verdict
    changed is as likely fixed as broken. Without a margin, an agent fails if significantly more
    worlds broke than were fixed, and passes if the opposite holds or none broke. With a margin, it
    passes if the increase of failing worlds is below the margin at 95 % confidence
    (non-inferiority). The bound is exact and conservative: it joins two Clopper-Pearson bounds.

    The suite's worlds were chosen by their results, so with a noisy agent some results change by
    chance (regression to the mean). `unlucky` corrects for this: a world that was tried but left
    out of the suite counts as a change in the other direction.

    Args:
        changes: The `change` of each world, see `CaseResult`.
        margin: The largest tolerated increase of the rate of failing worlds.
        unchanged: Whether the agent is the same as the one it is compared with.
        alarm: The accepted risk of failing an agent that is not worse.
        unlucky: How many worlds were tried as controls but failed, and as failures but passed.

    Raises:
        UserError: If no world can be compared.
    """
    check_margin(margin)
    compared = [change for change in changes if change != "not comparable"]
    if not compared:
        raise UserError(
            "Expected worlds that can be compared, got none: all of them are invalid, now or "
            "before. Check the environment."
        )
    n, broken = len(compared), sum(change in BROKEN for change in compared)
    fixed = compared.count("fixed")
    against, for_ = fixed + unlucky[0], broken + unlucky[1]
    worse, better = _p_value(broken, against), _p_value(fixed, for_)
    at_most = increase_at_most(broken, fixed, n)
    changed = f"{broken} of {n} worlds fail that passed before, and {fixed} were fixed"
    status: Status
    more = repeats = None
    if unchanged and not broken + fixed:
        status, reason = "passed", "It is the same agent in the same application"
    elif margin is not None and at_most <= margin:
        status = "passed"
        reason = f"The increase of failing worlds is at most {at_most:.1%}, within {margin:.1%}"
    elif worse <= alarm:
        status = "failed"
        reason = f"{changed} (p = {worse:.2g})"
    elif margin is not None:
        status, more = "inconclusive", _more_for_margin(broken, fixed, n, margin)
        repeats = None if more is None else -(-(n + more) // n)
        needed = "no number of such worlds would suffice"
        if more:
            needed = f"about {more:,} more are needed, {repeats} suites like this one in total"
        reason = (
            f"{n} worlds only show that the increase of failing worlds is at most {at_most:.1%}, "
            f"not {margin:.1%}: {needed}"
        )
    elif not broken:
        status = "passed"
        known = compared.count("still fails")
        remain = "1 known failure remains" if known == 1 else f"{known} known failures remain"
        reason = f"No regression: {fixed} fixed, {remain}, none new"
    elif better <= ALPHA:
        status = "passed"
        reason = f"{changed} (p = {better:.2g})"
    else:
        most, least, risk = (broken, against, alarm) if worse < better else (fixed, for_, ALPHA)
        status, more = "inconclusive", _more_discordant(most, least, risk)
        repeats = _repeats(most, least, risk)
        lucky = f", as {unlucky[0]} controls that were tried failed" if unlucky[0] else ""
        in_all = f", or about {repeats} suites like this one" if repeats else ""
        reason = (
            f"{changed}, which may be chance{lucky} "
            f"(p = {min(worse, better):.2g}): a decision takes at least {more} more worlds that "
            f"change in the same way{in_all}"
        )
    return Decision(
        status=status,
        reason=f"{reason}.".replace("%", " %"),
        worlds=n,
        broken=broken,
        fixed=fixed,
        p_worse=worse,
        p_better=better,
        increase=(broken - fixed) / n,
        at_most=at_most,
        margin=margin,
        more=more,
        repeats=repeats,
    )


def decide_ordinary(changes: Sequence[Change], *, margin: float | None, **known: Any) -> Decision:
    """Decide by ordinary worlds, see `decide`, with `ORDINARY_MARGIN` where nothing else does."""
    decision = decide(changes, margin=margin, **known)
    if margin is None and decision.status == "inconclusive":
        decision = decide(changes, margin=ORDINARY_MARGIN, **known)
    return decision


def combine(decision: Decision, ordinary: Decision | None) -> Decision:
    """Join what a suite's chosen worlds and its ordinary ones say: the worse of the two decides."""
    if ordinary is None:
        reason = f"{decision.reason} The suite holds no ordinary worlds: export it again."
        return decision.model_copy(update={"reason": reason})
    worse = max(decision, ordinary, key=lambda one: _ORDER.index(one.status))
    reasons = [decision.reason]
    if ordinary.reason != decision.reason:
        reasons.append(f"In ordinary worlds: {ordinary.reason}")
    return decision.model_copy(
        update={
            "status": worse.status,
            "reason": " ".join(reasons if worse is decision else reversed(reasons)),
            "more": worse.more,
            "repeats": worse.repeats,
        }
    )


def gate(decision: Decision, found: FailureEstimate, most: float) -> Decision:
    """Judge an agent by the probability of its failures in ordinary use as well.

    It passes where the 95 % interval lies below `most`, and fails where it lies above.
    """
    (low, high), more = found.interval, None
    status: Status = "passed" if high <= most else "failed" if low > most else "inconclusive"
    if found.refused is not None:
        status = "inconclusive"
    reason = f"{found.sentence}; at most {odds(most)} may"
    if status == "inconclusive":
        more = found.to_halve
        refused = "" if found.refused is None else f"; {found.refused}"
        reason = f"{reason}{refused}: about {more:,} more queries would halve the interval"
    arm = decision.model_copy(update={"status": status, "more": more, "repeats": None})
    worse = max(decision, arm, key=lambda one: _ORDER.index(one.status))
    return worse.model_copy(update={"reason": f"{decision.reason} In ordinary use: {reason}."})


def demand(
    decision: Decision,
    changes: Sequence[Change],
    *,
    max_failing: int | None = None,
    require_fixed: float | None = None,
) -> Decision:
    """Fail an agent of which more is asked than no regression.

    Args:
        decision: What `decide` says of these changes.
        changes: What became of each world.
        max_failing: How many worlds may fail.
        require_fixed: The share of the known failures that must be fixed.

    Raises:
        UserError: If an argument is out of its range.
    """
    check_integer("max_failing", max_failing or 0, 0, _MOST_WORLDS)
    if not 0.0 <= (require_fixed or 0.0) <= 1.0:
        raise UserError(f"Expected require_fixed from 0 to 1, such as 0.5, got {require_fixed}.")
    known = changes.count("still fails")
    failing, before = known + decision.broken, known + decision.fixed
    if max_failing is not None and failing > max_failing:
        reason = f"{failing} worlds fail; at most {max_failing} may."
    elif decision.fixed < (require_fixed or 0.0) * before:
        required = f"{require_fixed:.0%} must be".replace("%", " %")
        reason = f"{decision.fixed} of {before} known failures are fixed, and {required}."
    else:
        return decision
    return decision.model_copy(update={"status": "failed", "reason": reason})


def increase_at_most(broken: int, fixed: int, worlds: int) -> float:
    """Bound the increase of the failure rate from above, at 95 % confidence."""
    from scipy.stats import binomtest

    # where none is fixed, 0 bounds that rate from below for sure, and all risk is the other's
    level = 1.0 - ALPHA if not fixed else 1.0 - ALPHA / 2
    most = binomtest(broken, worlds, alternative="less").proportion_ci(level).high
    least = binomtest(fixed, worlds, alternative="greater").proportion_ci(1 - ALPHA / 2).low
    return float(most - least)


def _p_value(more: int, less: int) -> float:
    """Return the chance of so uneven a split of changed worlds, or a worse one."""
    from scipy.stats import binomtest

    if not more + less:
        return 1.0
    return float(binomtest(more, more + less, alternative="greater").pvalue)


def _more_discordant(most: int, least: int, risk: float) -> int:
    return next(k for k in count(1) if _p_value(most + k, least) <= risk)


def _repeats(most: int, least: int, risk: float) -> int | None:
    """Return how many suites with as many changed worlds would decide; None for too many."""
    fits = (k for k in range(2, _MOST_SUITES) if _p_value(k * most, k * least) <= risk)
    return next(fits, None)


def _more_for_margin(broken: int, fixed: int, worlds: int, margin: float) -> int | None:
    """Estimate how many more worlds show that an increase is within a margin, at these rates."""

    def shows(many: int) -> bool:
        scale = many / worlds
        bound = increase_at_most(round(broken * scale), round(fixed * scale), many)
        return bound <= margin

    low = high = worlds
    while not shows(high):
        low, high = high, 2 * high
        if high > _MOST_WORLDS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if shows(middle) else (middle, high)
    return high - worlds
