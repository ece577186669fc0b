"""The renderers of the detection application, a module each."""

from sada_gym.envs.detection.renderers.base import Renderer, Rendering

__all__ = ["Renderer", "Rendering", "default_renderer"]


def default_renderer() -> Renderer:
    """Give the process's one TinyRenderer, which is made on first use."""
    from sada_gym.envs.detection.renderers.tinyrenderer import shared_renderer

    return shared_renderer()
