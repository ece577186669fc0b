"""The renderers of the detection application, a module each."""

import functools

from sada_gym.envs.detection.renderers.base import Renderer, Rendering

__all__ = ["Renderer", "Rendering", "default_renderer"]


@functools.cache
def default_renderer() -> Renderer:
    """Give the process's one `Rasteriser`, made on first use: its kernels are loaded then."""
    from sada_gym.envs.detection.renderers.rasteriser import Rasteriser

    return Rasteriser()
