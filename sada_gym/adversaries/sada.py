"""`sada`: `level-set` as it was when the published results were made."""

from __future__ import annotations

from typing import ClassVar

from sada_gym.adversaries.level_set import LevelSet


class SADA(LevelSet):
    """Learns from the scores themselves, not from their ranks; all else is as in `level-set`.

    The published results hold rows of this adversary. It will be removed when they hold those of
    `level-set`.
    """

    name: ClassVar[str] = "sada"
    ranks: ClassVar[bool] = False
