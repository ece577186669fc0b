"""Object detection: the world, its renderer, its scoring.

Names are loaded on first use: the shapes and the renderer serve training without the environment.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sada_gym.envs.detection.application import DetectionApplication
    from sada_gym.envs.detection.env import DetectionEnv, DetectionVectorEnv

__all__ = ["DetectionApplication", "DetectionEnv", "DetectionVectorEnv"]


def __getattr__(name: str) -> Any:
    if name == "DetectionApplication":
        from sada_gym.envs.detection.application import DetectionApplication

        return DetectionApplication
    if name in __all__:
        from sada_gym.envs.detection import env

        return getattr(env, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
