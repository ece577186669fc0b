"""The table of the renderers, and how one is made by its name."""

from __future__ import annotations

import functools
from typing import Any

from sada_gym.envs.detection.renderers.base import Renderer, validate_renderer
from sada_gym.errors import UserError
from sada_gym.foundations.parts import find_part

RENDERERS: dict[str, str] = {
    "rasteriser": "sada_gym.envs.detection.renderers.rasteriser:Rasteriser",
    "blender": "sada_gym.envs.detection.renderers.blender:Blender",
}
"""Each renderer's `module:Class`. The class takes no argument and is loaded on first use."""

DEFAULT_RENDERER = "rasteriser"


def find_renderer(renderer: Any) -> Renderer:
    """Make a renderer by a key of `RENDERERS` or `module:Class`, or return a user's own one.

    Whoever has one made closes it.

    Raises:
        UserError: If there is no such renderer, or it is not a `Renderer`.
    """
    if not isinstance(renderer, str):
        return validate_renderer(renderer)
    kind = find_part("renderer", renderer, RENDERERS)
    if not (isinstance(kind, type) and issubclass(kind, Renderer)):
        raise UserError(f"Expected {renderer!r} to be a subclass of Renderer, got {kind!r}.")
    return validate_renderer(kind())


@functools.cache
def default_renderer() -> Renderer:
    """Return the default renderer that the process shares; its kernels are loaded on first use."""
    return find_renderer(DEFAULT_RENDERER)
