"""Digits under attack: the images, their warps, the classifier and its scoring.

Names are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sada_gym.envs.digits.application import DigitsApplication
    from sada_gym.envs.digits.env import DigitsEnv, DigitsVectorEnv

__all__ = ["DigitsApplication", "DigitsEnv", "DigitsVectorEnv"]


def __getattr__(name: str) -> Any:
    if name == "DigitsApplication":
        from sada_gym.envs.digits.application import DigitsApplication

        return DigitsApplication
    if name in __all__:
        from sada_gym.envs.digits import env

        return getattr(env, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
