"""The pixel attack: noise on an image, against the classifier of digits or a user's own.

Names are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sada_gym.envs.pixel.application import PixelApplication
    from sada_gym.envs.pixel.env import PixelEnv, PixelVectorEnv

__all__ = ["PixelApplication", "PixelEnv", "PixelVectorEnv"]


def __getattr__(name: str) -> Any:
    if name == "PixelApplication":
        from sada_gym.envs.pixel.application import PixelApplication

        return PixelApplication
    if name in __all__:
        from sada_gym.envs.pixel import env

        return getattr(env, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
