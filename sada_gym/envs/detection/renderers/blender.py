"""The paper's renderer: Cycles, in a Blender of its own that stays open from scene to scene."""

from __future__ import annotations

import io
import json
import math
import os
import threading
import time
import weakref
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.envs.detection.backdrop import Backdrop, random_backdrop
from sada_gym.envs.detection.renderers.base import Renderer, Rendering
from sada_gym.envs.detection.renderers.blender_process import (
    SCRIPT,
    TIMEOUT,
    BlenderDied,
    BlenderProcess,
    find_program,
    version_of,
)
from sada_gym.envs.detection.renderers.gbuffer import MATERIALS, painted
from sada_gym.envs.detection.renderers.rasteriser import Rasteriser
from sada_gym.envs.detection.scene import (
    FIELD_OF_VIEW_DEG,
    OCCLUDER_COLOUR,
    OCCLUDER_WIDTH,
    Pinhole,
    Scene,
    camera_of,
)
from sada_gym.envs.detection.shapes import fingerprint
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.errors import UserError, check_integer

SAMPLES = "SADA_GYM_BLENDER_SAMPLES"
"""The environment variable with the samples per pixel."""
SUN = (52.3, 46.0, 42.9)
"""The sun's beam above the air, as bright as white paper under it, in units of Blender's sky."""
SUN_WIDTH_DEG = 0.6
SKY = 2.5
"""How much brighter than Blender's the sky is: that one knows no light scattered twice."""
HAZE = 0.3
"""How bright air at the horizon is, as a share of white paper on the ground."""
EXPOSURE = 1.4
POLE_DISTANCE = 0.3
_COLOUR_AND_METAL = [0, 1, 2, 4]  # the columns of `MATERIALS`
DEFAULT_SAMPLES, DEFAULT_TIMEOUT_S = 16, 300.0


class Blender(Renderer):
    """Renders scenes with Cycles, by path tracing on one core.

    The scene is that of the rasteriser: camera, light, paint, ground and buildings. The light is
    the sun in a sky of Nishita's model, which takes its haze from the backdrop. Equal scenes give
    equal bytes on one machine; other processors and other versions of Blender may differ in the
    last bits. The object's mask and true box are those of the rasteriser, which sees the same mesh
    by the same camera.

    Args:
        samples: Paths per pixel. By default what the variable `SADA_GYM_BLENDER_SAMPLES` says,
            else 16.
        program: Blender's path. By default what `SADA_GYM_BLENDER` says, else `blender` on the
            PATH.
        timeout_s: Seconds that a picture may take. By default what
            `SADA_GYM_BLENDER_TIMEOUT_S` says, else 300.

    Raises:
        UserError: If Blender is missing or too old, or a number is out of range.
    """

    def __init__(
        self,
        *,
        samples: int | None = None,
        program: str | None = None,
        timeout_s: float | None = None,
    ) -> None:
        self.samples = int(_number(SAMPLES, samples, DEFAULT_SAMPLES))
        check_integer("samples", self.samples, 1, 4_096)
        self._timeout_s = _number(TIMEOUT, timeout_s, DEFAULT_TIMEOUT_S)
        self._program = find_program(program)
        self._version = version_of(self._program)
        self._flat = Rasteriser()
        self._process: BlenderProcess | None = None
        self._known: set[str] = set()
        self._seconds: dict[int, float] = {}
        self._lock = threading.Lock()

    @property
    def identity(self) -> str:
        """Blender's version, the samples, and the hash of the script that makes the scenes."""
        script = sha256(SCRIPT.read_bytes()).hexdigest()
        return json.dumps({"blender": self._version, "samples": self.samples, "script": script})

    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        """Make a square picture of `image_size` pixels a side of each scene, in the same order.

        Raises:
            UserError: If Blender dies twice at a scene, takes too long, or reports an error.
        """
        outlines = self._flat.render_batch(scenes, image_size)
        with self._lock:
            return [
                Rendering(self._picture(scene, image_size), outline.mask, outline.box)
                for scene, outline in zip(scenes, outlines, strict=True)
            ]

    def seconds_per_picture(self, image_size: int) -> float:
        """Draw an empty place of this size to find out how long a picture takes."""
        if image_size not in self._seconds:
            backdrop = random_backdrop(np.random.default_rng(0))
            scene = Scene(None, (0.5, 0.5, 0.5), 10.0, 0.0, 15.0, 60.0, 40.0, backdrop)
            self.render(scene, 16)  # the start of the program counts once, not for each world
            start = time.monotonic()
            self.render(scene, image_size)
            self._seconds[image_size] = time.monotonic() - start
        return self._seconds[image_size]

    def _picture(self, scene: Scene, size: int) -> npt.NDArray[np.uint8]:
        order = {**_order(scene), "size": size, "samples": self.samples}
        try:
            content = self._drawn(order, scene.shape)
        except BlenderDied:
            try:  # once more: it may have been killed from outside
                content = self._drawn(order, scene.shape)
            except BlenderDied as error:
                raise UserError(
                    f"Expected a picture from Blender {self._version} ({self._program}), but it "
                    f"died twice: {error} Try the program on its own; memory may be short."
                ) from error
        return _decoded(content, size)

    def _drawn(self, order: Mapping[str, Any], shape: Shape | None) -> bytes:
        if self._process is None or not self._process.usable:
            self.close()
            self._process = BlenderProcess(self._program, self._timeout_s)
            self._known.clear()
            weakref.finalize(self, self._process.close)
        if shape is None:
            return self._process.ask({**order, "shape": None})
        key = _key(shape)
        if key not in self._known:
            surfaces, arrays = _model(shape)
            self._process.ask({"model": key, "surfaces": surfaces}, arrays)
            self._known.add(key)
        return self._process.ask({**order, "shape": key})

    def __getstate__(self) -> dict[str, Any]:
        """Leave the process here: each worker starts its own."""
        return {**vars(self), "_process": None, "_known": set(), "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the settings."""
        self.__dict__.update(state, _lock=threading.Lock())

    def close(self) -> None:
        """End Blender; twice is fine. The next picture starts it again."""
        process, self._process = self._process, None
        if process is not None:
            process.close()


def _order(scene: Scene) -> dict[str, Any]:
    """Write down all of a scene but its mesh."""
    camera = camera_of(scene)
    return {
        "camera": {
            "eye": camera.eye.tolist(),
            "axes": camera.axes.tolist(),
            "angle": math.radians(FIELD_OF_VIEW_DEG),
            "shift": [0.5 * offset for offset in camera.offset],
        },
        "pole": None if scene.occluder is None else _pole(scene.occluder, camera),
        "sun": _sun(scene),
        "materials": painted(scene.colour)[:, _COLOUR_AND_METAL].tolist(),
        "backdrop": scene.backdrop.to_dict(),
        "seed": int(scene.seed) % 2**31,
    }


def _pole(shift: float, camera: Pinhole) -> dict[str, Any]:
    """Place `Scene.occluder`: nearer than it is and as much smaller, so that no ground hides it."""
    right, up, back = camera.axes
    x, y = (
        POLE_DISTANCE * camera.tangent * place
        for place in (shift + camera.offset[0], camera.offset[1])
    )
    # beside the picture's middle, perspective widens a cylinder
    widened = math.hypot(1.0, x / POLE_DISTANCE)
    radius = OCCLUDER_WIDTH * POLE_DISTANCE * camera.tangent / widened
    length = 2 * POLE_DISTANCE * camera.tangent
    return {
        "middle": (camera.eye - POLE_DISTANCE * back + x * right + y * up).tolist(),
        "axes": [(radius * right).tolist(), (length * up).tolist(), (radius * back).tolist()],
        "colour": [0.02 + 0.9 * channel**2.2 for channel in OCCLUDER_COLOUR],
    }


def _model(shape: Shape) -> tuple[list[dict[str, Any]], dict[str, npt.NDArray[Any]]]:
    """Write down a shape: its surfaces, and its arrays with the textures of those."""
    arrays = {name: getattr(shape, name) for name in shape.array_types}
    arrays["materials"] = arrays["materials"].astype(np.int32)
    surfaces = []
    for number, surface in enumerate(shape.surfaces):
        texture = surface.texture
        if texture is not None:  # Blender's pictures begin at the bottom
            arrays[f"texture {number}"] = texture[::-1].astype(np.float32) / np.float32(255)
        metal = float(MATERIALS[surface.material, _COLOUR_AND_METAL[3]])
        surfaces.append(
            {
                "material": int(surface.material),
                "colour": [*(0.9 * channel**2.2 for channel in surface.colour), metal],
                "opacity": surface.opacity,
                "painted": surface.painted,
                "texture": None if texture is None else [texture.shape[1], texture.shape[0]],
            }
        )
    return surfaces, arrays


def _sun(scene: Scene) -> dict[str, Any]:
    """Say where the sun stands and how bright sun and sky are, exposed as a camera would."""
    pitch_deg = max(scene.light_pitch_deg, 0.0)
    pitch = math.radians(scene.light_pitch_deg)
    dust = 0.6 + 3.0 * _greyness(scene.backdrop)
    # fitted to the sun's disc in Blender's sky: extinction by Beer and Lambert, and the air mass of
    # Kasten and Young (1989)
    air = 1 / (math.sin(math.radians(pitch_deg)) + 0.50572 * (pitch_deg + 6.07995) ** -1.6364)
    extinction = [rate + 0.026 * dust for rate in (0.053, 0.104, 0.241)]
    beam = [white * math.exp(-k * air) for white, k in zip(SUN, extinction, strict=True)]
    slope, across = max(math.sin(pitch), 0.0), math.cos(pitch)
    metered = 2.5 * SKY + beam[1] * (0.5 * slope + 0.25 * across)
    gain = EXPOSURE / metered
    return {
        "azimuth": math.radians(scene.camera_azimuth_deg + scene.light_azimuth_deg),
        "pitch": pitch,
        "angle": math.radians(SUN_WIDTH_DEG),
        "dust": dust,
        "sky": SKY * gain,
        "haze": [HAZE * (beam[1] * slope + 2.0) / SKY * c for c in scene.backdrop.horizon],
        "colour": [math.pi * gain * channel for channel in beam],
    }


def _greyness(backdrop: Backdrop) -> float:
    """Return how grey a sky is, 0 for the bluest that `random_backdrop` draws, 1 for grey."""
    red, _, blue = backdrop.zenith
    saturation = 1 - math.pow(max(red, 0.0) / max(blue, 1e-6), 1 / 2.2)
    return min(max(1 - saturation / 0.65, 0.0), 1.0)


_keys: weakref.WeakKeyDictionary[Shape, str] = weakref.WeakKeyDictionary()


def _key(shape: Shape) -> str:
    key = _keys.get(shape)
    if key is None:
        key = _keys[shape] = fingerprint((shape,))
    return key


def _number(variable: str, given: float | None, default: float) -> float:
    text = os.environ.get(variable) if given is None else given
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        what = variable if given is None else variable.removeprefix("SADA_GYM_BLENDER_").lower()
        raise UserError(f"Expected {what} to be a number above 0, got {text!r}.")
    return value


def _decoded(content: bytes, size: int) -> npt.NDArray[np.uint8]:
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as file:
            picture = np.asarray(file.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise UserError(
            f"Expected a picture of {size} pixels a side from Blender, got a file that cannot be "
            f"read ({error}). The disk with its folder of temporary files may be full."
        ) from error
    if picture.shape != (size, size, 3):
        raise UserError(
            f"Expected a picture of {size} pixels a side from Blender, got {picture.shape[1]} x "
            f"{picture.shape[0]}."
        )
    return picture
