"""The renderers of the detection application, a module each."""

from sada_gym.envs.detection.renderers.base import Renderer, Rendering
from sada_gym.envs.detection.renderers.registry import default_renderer, find_renderer

__all__ = ["Renderer", "Rendering", "default_renderer", "find_renderer"]
