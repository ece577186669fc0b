"""`level-set`: learn where the agent fails from the ranks of all scores, and sample it evenly."""

from __future__ import annotations

from typing import ClassVar

from sada_gym.adversaries.sada import SADA


class LevelSet(SADA):
    """Learns from the ranks of all scores where the agent fails, and samples that set evenly.

    `sada` regresses the scores themselves. A softmax is near 0 or 1 almost everywhere, and the
    threshold may lie at 1e-4: the differences that decide are then invisible to a squared error.
    A rank knows no scale, so what this adversary learns does not depend on how Q is scaled. All
    else is as in `sada`, whose place it is to take.
    """

    name: ClassVar[str] = "level-set"
    ranks: ClassVar[bool] = True
