"""A scene as plain data, which renderers draw, and where its camera and its light stand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.backdrop import Backdrop
from sada_gym.envs.detection.shapes.catalogue import find_shape
from sada_gym.envs.detection.shapes.model import Shape, check_keys
from sada_gym.errors import UserError

FIELD_OF_VIEW_DEG = 42.0

OCCLUDER_WIDTH = 0.15
"""The share of the picture's width that the pole covers (the paper's appendix, "Diagnosis")."""

OCCLUDER_DISTANCE = 4.0
"""From the camera to the pole, in scene units; the object is farther away."""

OCCLUDER_COLOUR = (0.55, 0.55, 0.55)
"""The pole's sRGB, matt."""

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """One object in an urban place, seen and lit from somewhere.

    Azimuths run counter-clockwise seen from above. A camera azimuth of 0 looks at the object's
    front; the light's azimuth is relative to the camera's, so 0 lights from behind the camera and
    180 is backlight. Pitches are above the horizon.

    A scene is data alone. `to_dict` and `to_json` give all that a renderer in another process or
    of another program needs to know.

    Attributes:
        shape: The object; None leaves the place empty.
        colour: Its paint, sRGB in [0, 1].
        camera_distance: From the object's centre, in scene units.
        aim: Where the camera looks, as an offset (right, up) from the object's centre in units of
            half the image's height.
        seed: Seeds a renderer that draws random numbers; the default one draws none.
        occluder: Where a pole stands between camera and object: the shift of its middle from the
            picture's middle, to the right, in units of half the picture's width; from -1 to 1 it
            moves from one edge of the picture to the other. None: there is no pole. The pole is
            upright in the picture and as high, covers `OCCLUDER_WIDTH` of its width, is
            `OCCLUDER_DISTANCE` away from the camera, opaque and grey, and casts no shadow. It
            does not change the object's true box and mask, which are those without it.
    """

    shape: Shape | None
    colour: tuple[float, float, float]
    camera_distance: float
    camera_azimuth_deg: float
    camera_pitch_deg: float
    light_azimuth_deg: float
    light_pitch_deg: float
    backdrop: Backdrop
    aim: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    occluder: float | None = None

    @property
    def shape_name(self) -> str:
        """The object's name, empty where there is none."""
        return "" if self.shape is None else self.shape.name

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as numbers, texts, lists and dictionaries.

        A shape of the benchmark is its name. Any other is `Shape.to_dict`, with its mesh in arrays.
        `occluder` is left out where there is none.
        """
        occluder = {} if self.occluder is None else {"occluder": float(self.occluder)}
        return {
            "shape": _plain_shape(self.shape),
            "colour": [float(channel) for channel in self.colour],
            **{name: float(getattr(self, name)) for name in PLACEMENT},
            "backdrop": self.backdrop.to_dict(),
            "aim": [float(offset) for offset in self.aim],
            "seed": int(self.seed),
            **occluder,
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Scene:
        """Make the scene that `to_dict` returned; a mesh may be given in arrays or in lists.

        Raises:
            UserError: If a key is missing or unknown, or the shape's name is.
        """
        names = ("shape", "colour", *PLACEMENT, "backdrop", "aim", "seed")
        check_keys("a scene", plain, names, ("occluder",))
        occluder = plain.get("occluder")
        red, green, blue = map(float, plain["colour"])
        right, up = map(float, plain["aim"])
        return cls(
            shape=_shape(plain["shape"]),
            colour=(red, green, blue),
            **{name: float(plain[name]) for name in PLACEMENT},
            backdrop=Backdrop.from_dict(plain["backdrop"]),
            aim=(right, up),
            seed=int(plain["seed"]),
            occluder=None if occluder is None else float(occluder),
        )

    def to_json(self) -> str:
        """Write `to_dict` as JSON, which keeps every number to the last bit."""
        return json.dumps(self.to_dict(), default=np.ndarray.tolist, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Scene:
        """Make the scene that `to_json` wrote; it raises what `from_dict` raises."""
        return cls.from_dict(json.loads(text))


PLACEMENT = (
    "camera_distance",
    "camera_azimuth_deg",
    "camera_pitch_deg",
    "light_azimuth_deg",
    "light_pitch_deg",
)
"""The attributes of a scene that place its camera and its light."""


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A pinhole camera at an eye, (3,), with axes, (3, 3): unit vectors right, up, backward.

    `tangent` is half the image's height at distance 1, `offset` the principal point in units of
    half the image, (right, up).
    """

    eye: Vector
    axes: Vector
    tangent: float
    offset: tuple[float, float]


def direction(azimuth_deg: float, pitch_deg: float) -> Vector:
    """Return the unit vector from the object towards an azimuth and a pitch."""
    azimuth, pitch = math.radians(azimuth_deg), math.radians(pitch_deg)
    across = math.cos(pitch)
    return np.array([across * math.cos(azimuth), across * math.sin(azimuth), math.sin(pitch)])


def axes_facing(backward: Vector) -> Vector:
    """Return the axes of a viewer who looks along -backward, z up: rows right, up, backward."""
    x, y, z = backward.tolist()
    norm = math.hypot(x, y)
    right, ahead = (-y / norm, x / norm) if norm > 1e-9 else (0.0, 1.0)
    up = (-z * ahead, z * right, x * ahead - y * right)
    return np.array([(right, ahead, 0.0), up, (x, y, z)])


def centre_of(scene: Scene) -> Vector:
    """Return the point that camera and light look at: the middle of the object's bounding box."""
    return np.array([0.0, 0.0, 0.5 * scene.shape.height if scene.shape is not None else 1.0])


def camera_of(scene: Scene) -> Pinhole:
    """Place the camera of a scene."""
    backward = direction(scene.camera_azimuth_deg, scene.camera_pitch_deg)
    return Pinhole(
        eye=centre_of(scene) + scene.camera_distance * backward,
        axes=axes_facing(backward),
        tangent=math.tan(math.radians(FIELD_OF_VIEW_DEG) / 2),
        offset=scene.aim,
    )


def light_of(scene: Scene) -> Vector:
    """Return the unit vector from the object towards the light."""
    return direction(scene.camera_azimuth_deg + scene.light_azimuth_deg, scene.light_pitch_deg)


def _plain_shape(shape: Shape | None) -> str | dict[str, Any] | None:
    if shape is None:
        return None
    known = find_shape(shape.name)
    return shape.name if known is not None and known.equals(shape) else shape.to_dict()


def _shape(plain: str | Mapping[str, Any] | None) -> Shape | None:
    if plain is None:
        return None
    if not isinstance(plain, str):
        return Shape.from_dict(plain)
    shape = find_shape(plain)
    if shape is None:
        raise UserError(
            f"Expected the name of a shape, such as car/saloon-0, got {plain!r}. Give the mesh of "
            "a shape of your own, as Shape.to_dict writes it."
        )
    return shape
