"""The renderers of the detection application, a module each."""

import functools

from sada_gym.envs.detection.renderers.base import Renderer, Rendering

__all__ = ["Renderer", "Rendering", "default_renderer"]


@functools.cache
def default_renderer() -> Renderer:
    """Give the process's one TinyRenderer, made on first use: a PyBullet client costs 30 MB."""
    from sada_gym.envs.detection.renderers.rasteriser import Rasteriser

    return Rasteriser()
