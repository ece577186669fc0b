"""The renderers of the detection application, a module each."""

from sada_gym.envs.detection.renderers.base import (
    Renderer,
    Rendering,
    default_renderer,
    find_renderer,
)

__all__ = ["Renderer", "Rendering", "default_renderer", "find_renderer"]
