"""The base of all renderers, which turn scenes into pictures, and the table of ours."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.scene import Scene
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import check_unmasked
from sada_gym.foundations.parts import find_part

DEFAULT_KEY = "Rasteriser"
"""The default renderer in the settings of stores and published results."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """A picture of a scene, (size, size, 3) uint8 RGB, and what is known of the object in it.

    Mask and box are those of the object without a pole before it, see `Scene.occluder`.

    Attributes:
        mask: (size, size) bool, pixels mostly covered by the object.
        box: (4,) float64, x0 y0 x1 y1 in pixels; None where no object is in sight.
    """

    image: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]
    box: npt.NDArray[np.float64] | None


class Renderer(ABC):
    """Makes pictures of scenes; subclass it for a renderer of your own.

    A renderer is pure: the same scene and size give the same bytes, whatever else is in the batch,
    in any process. One that draws random numbers seeds them with `Scene.seed`.

    Whoever makes a renderer closes it: an application closes the one that it made by a name, and
    leaves the one that it was given open.

    Attributes:
        any_size: Whether a larger picture shows the same scene in more detail and is drawn quickly
            enough for videos. Otherwise videos enlarge what the detector sees.
    """

    any_size: ClassVar[bool] = False

    @property
    def identity(self) -> str | None:
        """What a picture depends on besides the scene: a name, the version, the settings.

        Any text does, such as JSON; evaluation stores hold its hash. With None, the default, a
        store is refused, because it could not tell this renderer's scores from another's.
        """
        return None

    @property
    def key(self) -> str:
        """The renderer in the settings of stores: its class and its identity's SHA-256."""
        name, identity = type(self).__name__, self.identity
        return name if identity is None else f"{name}-{sha256(identity.encode()).hexdigest()}"

    @abstractmethod
    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        """Make a square picture of `image_size` pixels a side of each scene, in the same order."""

    def render(self, scene: Scene, image_size: int) -> Rendering:
        """Make the picture of one scene."""
        return self.render_batch([scene], image_size)[0]

    def seconds_per_picture(self, image_size: int) -> float | None:  # noqa: ARG002
        """Return about how long a picture takes; None, the default, where it is fast."""
        return None

    def close(self) -> None:  # noqa: B027 - most renderers hold nothing
        """Free what the renderer holds; calling it twice is fine."""


def validate_renderer(renderer: Any) -> Renderer:
    """Return a user's renderer.

    Raises:
        UserError: If it is not a `Renderer`, or its identity is not a text.
    """
    if not isinstance(renderer, Renderer):
        raise UserError(
            f"Expected a renderer that is a sada_gym.envs.detection.renderers.Renderer, got "
            f"{renderer!r}. Subclass Renderer and implement render_batch."
        )
    identity = renderer.identity
    if identity is not None and not (isinstance(identity, str) and identity):
        raise UserError(
            f"Expected the identity of {type(renderer).__name__} to be a text, or None, got "
            f"{identity!r}. Write down its version and settings, such as with json.dumps."
        )
    return renderer


def validate_renderings(
    renderings: Any, renderer: Renderer, count: int, image_size: int
) -> list[Rendering]:
    """Return what `render_batch` returned.

    Raises:
        UserError: If it is not one `Rendering` a scene with arrays of the shapes that it names.
    """
    name = f"{type(renderer).__name__}.render_batch"
    if not isinstance(renderings, Sequence) or len(renderings) != count:
        got = f"{len(renderings)} items" if isinstance(renderings, Sequence) else f"{renderings!r}"
        raise UserError(f"Expected {count} renderings from {name}, one a scene, got {got}.")
    square = (image_size, image_size)
    for rendering in renderings:
        if not isinstance(rendering, Rendering):
            raise UserError(f"Expected Rendering objects from {name}, got {rendering!r}.")
        for what, shape, dtype in (("image", (*square, 3), np.uint8), ("mask", square, np.bool_)):
            array = getattr(rendering, what)
            check_unmasked(array, what)
            came = np.shape(array), getattr(array, "dtype", None)
            if came != (shape, np.dtype(dtype)):
                raise UserError(
                    f"Expected an {what} of shape {shape} and dtype {np.dtype(dtype)} from {name}, "
                    f"got shape {came[0]} and dtype {came[1]}."
                )
        box = rendering.box
        if box is not None and (np.shape(box) != (4,) or not np.isfinite(box).all()):
            raise UserError(
                f"Expected a box of four finite numbers, x0 y0 x1 y1, or None from {name}, got "
                f"{box!r}."
            )
    return list(renderings)


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
