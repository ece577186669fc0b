"""What makes the pictures of the detection application: one module a renderer."""

from sada_gym.envs.detection.renderers.base import Renderer, Rendering

__all__ = ["Renderer", "Rendering", "default_renderer"]


def default_renderer() -> Renderer:
    """The process's one TinyRenderer, which is loaded on first use and lives as long as it."""
    from sada_gym.envs.detection.renderers.tinyrenderer import shared_renderer

    return shared_renderer()
